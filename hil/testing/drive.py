"""The folder of a simulated axis, and a simulated CiA 402 drive on a CAN bus, served by a thread in real time, for tests."""

from __future__ import annotations

import queue
import threading
import uuid
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import can
import pytest

from drivers.clock import NS_PER_S, WallClock
from drivers.errors import StateError
from drivers.files import replace_file
from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key
from hil.machine.simulated_file import axis_text, instrument_text
from hil.script.open_axis import OpenAxis
from sim_backends.bench import Bench, BenchParameters, known_bench
from sim_backends.canopen_faults import CanFault
from sim_backends.fault_text import Faults, parse_faults
from sim_backends.faults import CanFaultKind, Fault
from sim_backends.machine import CanDrive, open_bus
from sim_backends.serve import Pace, run_in_real_time

PASSWORDS = {"HIL_PASSWORD": "tables of a simulated axis", "HIL_KEY_PASSWORD": "builder of a simulated axis"}
MACHINE = "typical"
QUICK = Cost(n=1 << 10, r=8, p=1)
SHORT = "dwell_s = 0.1\nreading_s = 0.1\n"
"""At the end of [measurement]."""
NODE = 1
ENDING_S = 10.0
"""Time limit for the thread to end, s."""

Timed = TypeVar("Timed", Fault, CanFault)


def machine_parameters() -> BenchParameters:
    """The machine of the fixtures."""
    return known_bench(MACHINE, 0)


def lay_out(folder: Path, monkeypatch: pytest.MonkeyPatch, drive: dict[str, Any] | None = None, port: str = "") -> Path:
    """Write X.toml, builder.key and builder.pub, and set the passwords; the axis file. drive: keys of [drive], None: of the bench;
    port: of its laser."""
    for name, value in PASSWORDS.items():
        monkeypatch.setenv(name, value)
    key = new_key()
    save_private_key(folder / "builder.key", key, PASSWORDS["HIL_KEY_PASSWORD"], cost=QUICK)
    save_public_key(folder / "builder.pub", key.public_key())
    place = drive or {"backend": "bench", "machine": MACHINE, "seed": 0, "face": "canopen"}
    path = folder / "X.toml"
    replace_file(path, (axis_text(machine_parameters(), place, instrument_text("umd", port)) + SHORT).encode())
    return path


def add_to_bench(bench: Bench, found: Faults) -> None:
    """Add faults of motor and laser, whose times count from now."""
    bench.servo.add_faults(from_now(bench, found.servo))
    bench.laser.add_faults(from_now(bench, found.laser))


def from_now(bench: Bench, faults: tuple[Timed, ...]) -> tuple[Timed, ...]:
    """Faults whose times count from the start of the bench's clock."""
    now_s = bench.clock.now_ns() / NS_PER_S
    return tuple(replace(one, at_s=one.at_s + now_s) for one in faults)


class SimulatedDrive:
    """A running drive. axis_file: for `hil.open`; interface, channel, node_id: its place, for a bus of the test's own."""

    def __init__(self, bench: Bench, bus: can.BusABC, place: dict[str, Any], axis_file: Path) -> None:
        self.axis_file = axis_file
        self.interface, self.channel, self.node_id = str(place["interface"]), str(place["channel"]), NODE
        self._bench = bench
        self._pace = Pace(bench.clock, WallClock())
        self._drive = CanDrive(bench, self._pace, bus, NODE)
        self._asked: queue.SimpleQueue[tuple[Faults, threading.Event]] = queue.SimpleQueue()
        self._ending = threading.Event()
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="simulated drive", daemon=True)

    @property
    def powered(self) -> bool:
        """Whether the motor is under power."""
        return self._bench.servo.powered

    @property
    def moving(self) -> bool:
        """Whether the motor turns."""
        return self._bench.servo.velocity_actual_counts_s != 0

    @property
    def position_mm(self) -> float:
        """The load's true position, mm."""
        return self._bench.plant.position_mm

    def fault(self, text: str) -> None:
        """What goes wrong, as the fixture `fault`; on return it is scheduled. Raises InputError, and StateError where the thread has
        ended."""
        taken = threading.Event()
        self._asked.put((parse_faults([text], wire=CanFaultKind), taken))
        if not taken.wait(ENDING_S):
            raise StateError(f"the simulated drive does not run: {self._error}")

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def end(self) -> None:
        """End the thread. Raises what it raised."""
        self._ending.set()
        self._thread.join(ENDING_S)
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        try:
            run_in_real_time(self._pace, keep_running=lambda: not self._ending.is_set(), idle=self._serve)
        except BaseException as error:  # noqa: BLE001  the test's thread raises it
            self._error = error

    def _serve(self, timeout_s: float) -> None:
        while not self._asked.empty():
            found, taken = self._asked.get()
            add_to_bench(self._bench, found)
            self._drive.add_faults(from_now(self._bench, found.can))
            taken.set()
        self._drive.serve(timeout_s)


@contextmanager
def running_drive(wire: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SimulatedDrive]:
    """A drive on "virtual", "vcan0" or "slcan", with its axis file in a folder. Raises LinkLostError for a bus that is not there."""
    with ExitStack() as stack:
        bench = stack.enter_context(Bench(machine_parameters(), wait_for_arrival=False))
        place = _place(wire)
        bus = open_bus("slcan-pty" if wire == "slcan" else place["interface"], place["channel"], None)
        stack.callback(bus.shutdown)
        if wire == "slcan":
            place["channel"] = bus.channel_info
        file = lay_out(folder, monkeypatch, {"backend": "canopen", **place, "node_id": NODE}, bench.laser_path)
        drive = SimulatedDrive(bench, bus, place, file)
        stack.callback(drive.end)
        drive.start()
        yield drive


def _place(wire: str) -> dict[str, Any]:
    if wire == "virtual":
        return {"interface": "virtual", "channel": f"hil-{uuid.uuid4().hex}"}
    return {"interface": "socketcan", "channel": wire} if wire == "vcan0" else {"interface": "slcan", "channel": ""}


def fault_of(machine: OpenAxis | SimulatedDrive) -> Callable[[str], None]:
    """The fixture `fault` of a machine."""
    if isinstance(machine, SimulatedDrive):
        return machine.fault
    return lambda text: add_to_bench(machine.bench, parse_faults([text]))
