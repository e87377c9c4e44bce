"""Time from the operator's stop to the stop on the wire, worst of 200 moments: `python tests/study/stop_latency.py`.

Simulated time: every verb that moves, on CANopen with SDO alive and dead, on Modbus TCP. Wall time: real threads, two busy processes,
a python-can virtual bus, a loopback port, a pseudo-terminal. Each row is printed; `--write` puts the worst of the jobs of each
wire into hil/docs/stopping.md.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from random import Random
from typing import Any

if __name__ == "__main__":  # the folder of a script is first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from hostile.places import VERBS
from hostile.stops import BOUND_S, Stopped, controlword_of, stopped_at, stops
from support.served_drive import served

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.clock import WallClock
from drivers.drive import ServoDrive
from drivers.errors import BridgeError
from drivers.limits import DriveLimits
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.ports import Check
from drivers.modbus.wire import PymodbusWire, Request
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from hil.desk.stop import Pacing, Stop, StoppedByOperator
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.faults import WireFaultKind
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import rtu_slave, tcp_server
from sim_backends.modbus_faults import WireFault
from sim_backends.servo import SimulatedServo

PAGE = Path(__file__).parents[2] / "hil" / "docs" / "stopping.md"
SIMULATED = (("canopen", False), ("canopen", True), ("modbus-tcp", False))
LIMITS = DriveLimits(-300.0, 300.0, 200.0, 2000.0)
NODE = 5
SEEN_S = 1.0
"""Longest time for a stop to reach a drive, before it is confirmed, s."""
READY_S = 20.0
"""Longest time until a drive is available again after the stop before, s."""


@dataclass(frozen=True)
class Row:
    """Stops of one work on one wire. times_s: as the table has them; requests: most between a stop and its frame, None on CAN."""

    wire: str
    work: str
    stops: int
    times_s: tuple[float, ...]
    requests: int | None

    def line(self) -> str:
        times = " | ".join(f"{1e3 * one_s:.1f} ms" for one_s in self.times_s)
        return (
            f"| {self.wire} | {self.work} | {self.stops} | {times} | {'' if self.requests is None else self.requests} |"
        )


def worst(rows: Sequence[Row]) -> Iterator[Row]:
    """The rows of each wire as one: how many works, their stops together, of each time and of the requests the largest."""
    for wire in dict.fromkeys(row.wire for row in rows):
        own = [row for row in rows if row.wire == wire]
        times = tuple(map(max, zip(*(row.times_s for row in own), strict=True)))
        requests = max((row.requests for row in own if row.requests is not None), default=None)
        yield Row(wire, str(len(own)), sum(row.stops for row in own), times, requests)


# -- simulated time --------------------------------------------------------------------------------------------------------
def simulated_row(face: str, sdo_dead: bool, verb: str, moments: int, pool: ProcessPoolExecutor) -> Row:
    """The moments are spread evenly over the verb."""
    shares = [(number + 0.37) / moments for number in range(moments)]
    found: list[Stopped] = list(pool.map(partial(stopped_at, face, verb, sdo_dead=sdo_dead), shares, chunksize=5))
    under = [one for one in found if one.under_power]
    wire = f"CANopen, SDO {'dead' if sdo_dead else 'alive'}" if face == "canopen" else "Modbus TCP"
    requests = None if face == "canopen" else max((one.requests for one in under), default=0)
    return Row(wire, verb, len(under), (max((one.latency_s for one in under), default=0.0),), requests)


class CountedWire(PymodbusWire):
    """Records when each request began and ended, and when posted stops were sent, s."""

    def __init__(self, endpoint: Endpoint, check: Check) -> None:
        super().__init__(endpoint, check)
        self.requests: list[tuple[float, float]] = []
        self.left: list[float] = []
        stops: set[bytes] = set()
        post, written = self._port.post, getattr(self._port, "_put", None)

        def posted(frames: Sequence[bytes]) -> None:
            stops.update(frames)
            if written is None:
                self.left.append(time.monotonic())
            post(frames)

        def put(port: Any, frame: bytes, check: Check) -> None:
            if frame in stops:
                self.left.append(time.monotonic())
            written(port, frame, check)  # type: ignore[misc]

        self._port.post = posted  # type: ignore[method-assign]
        if written is not None:
            self._port._put = put  # type: ignore[attr-defined]

    def exchange(self, unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        began_s = time.monotonic()
        try:
            return super().exchange(unit, request, within_s)
        finally:
            self.requests.append((began_s, time.monotonic()))

    def before_stop(self, pressed_s: float) -> tuple[float, int]:
        """Of the first stop after this time: delay until it was sent, and the requests in progress or begun meanwhile."""
        left_s = min(when for when in self.left if when >= pressed_s)
        return left_s - pressed_s, sum(began < left_s and ended > pressed_s for began, ended in self.requests)


# -- wall time ---------------------------------------------------------------------------------------------------------------
@dataclass
class Rig:
    """One drive over a real wire in real threads. dead(True): answers are lost from now on; seen: times of stops on the wire, s.

    On Modbus `seen` holds the times of orders to the servo.
    """

    drive: ServoDrive
    stop: Stop
    dead: Callable[[bool], None]
    seen: list[float] = field(default_factory=list)
    wire: CountedWire | None = None  # of Modbus


def _servo() -> SimulatedServo:
    return SimulatedServo(BareShaft(), SMALL_SERVO)


@contextmanager
def canopen_rig() -> Iterator[Rig]:
    stop, channel, servo = Stop(), uuid.uuid4().hex, _servo()
    clock = WallClock(Pacing(stop))
    with (
        served(servo, WallClock(), interface="virtual", channel=channel, node_id=NODE),
        CanLink.open(clock, interface="virtual", channel=channel) as link,
    ):
        settings = CanOpenSettings(homing=HomingSettings(method=37, home_position_mm=0.0), sample_timeout_s=1.0)
        scaling = AxisScaling(SMALL_SERVO.counts_per_rev, 10.0)
        is_dead = threading.Event()
        rig = Rig(
            CanOpenDrive("X", scaling, LIMITS, clock, link=link, node_id=NODE, settings=settings),
            stop,
            lambda dead: is_dead.set() if dead else is_dead.clear(),
        )
        send = link.bus.send

        def tapped(message: Any, timeout: float | None = None) -> None:
            word = controlword_of(message.arbitration_id, bytes(message.data), NODE)
            if word is not None and stops(word):
                rig.seen.append(time.monotonic())
            if not (is_dead.is_set() and message.arbitration_id == 0x600 + NODE):
                send(message, timeout)

        link.bus.send = tapped  # type: ignore[method-assign]
        yield rig


@contextmanager
def modbus_rig(*, serial: bool) -> Iterator[Rig]:
    stop, servo = Stop(), _servo()
    clock = WallClock(Pacing(stop))
    face = Cia402Registers(servo, parameters={(0x6098, 0): 37, (0x6085, 0): 20_000_000})
    with rtu_slave({7: face}, WallClock()) if serial else tcp_server({7: face}, WallClock()) as (server, place):
        endpoint = RtuEndpoint(str(place), 115_200, "N") if serial else TcpEndpoint("127.0.0.1", int(place))
        wire = CountedWire(endpoint, clock.check_interrupt)
        link = ModbusLink(endpoint, clock, make_wire=lambda _endpoint: wire)
        scaling = AxisScaling(SMALL_SERVO.counts_per_rev, 10.0)
        drive = ModbusDrive(
            "X", scaling, LIMITS, clock, link=link, unit=7, drive_map=load_drive_map("cia402_over_modbus")
        )
        silent = WireFault(WireFaultKind.NO_REPLY, count=1 << 30)
        rig = Rig(drive, stop, lambda dead: server.faults.add(silent) if dead else server.faults.clear(), wire=wire)
        for order in ("quick_stop", "halt", "power_off"):
            _tap(rig, servo, order)
        ended = threading.Event()

        def advance() -> None:
            before_ns = time.monotonic_ns()
            step = server.guard(servo.advance)
            while not ended.wait(0.001):
                now_ns = time.monotonic_ns()
                step(now_ns, (now_ns - before_ns) * 1e-9)
                server.advance(now_ns, 0.0)
                before_ns = now_ns

        thread = threading.Thread(target=advance, daemon=True)
        thread.start()
        try:
            yield rig
        finally:
            ended.set()
            thread.join()


def _tap(rig: Rig, servo: SimulatedServo, order: str) -> None:
    carry_out = getattr(servo, order)

    def noted(*arguments: Any) -> None:
        rig.seen.append(time.monotonic())
        carry_out(*arguments)

    setattr(servo, order, noted)


def _move(drive: ServoDrive) -> None:
    here = drive.sample().position_load_mm
    drive.start_move(-200.0 if here > 0.0 else 200.0, 50.0)
    drive.wait_for(lambda sample: sample.target_reached, 60.0, "arrived")


def _home(drive: ServoDrive) -> None:
    while True:
        drive.start_homing()
        drive.wait_for(lambda sample: sample.homed is True, 60.0, "homed")


def _stream(drive: ServoDrive) -> None:
    here = drive.sample().position_load_mm
    with drive.stream(SetPointSettings(0.05, following_error_mm=50.0, missed_limit=1000)) as stream:
        while True:
            stream.cycle([here])


def _watch(drive: ServoDrive) -> None:
    drive.wait_for(lambda _sample: False, 60.0, "nothing")


WORKS: dict[str, Callable[[ServoDrive], None]] = {"move": _move, "homing": _home, "stream": _stream, "watching": _watch}
WIRES: dict[str, Callable[[], Any]] = {
    "CANopen": canopen_rig,
    "Modbus TCP": partial(modbus_rig, serial=False),
    "Modbus RTU, 115 200 baud": partial(modbus_rig, serial=True),
}


def _make_ready(rig: Rig) -> None:
    """Enabled, whatever state the stop before has left."""
    rig.dead(False)
    rig.stop.rearm()
    with suppress(StoppedByOperator):
        rig.stop.check()  # clears a press that no wait has seen
    rig.stop.rearm()
    deadline_s = time.monotonic() + READY_S
    while True:
        with suppress(BridgeError):
            rig.drive.close()
        try:
            rig.drive.open()
            rig.drive.disable()
            rig.drive.enable()
            return
        except BridgeError:  # a silent unit is in back-off for a while
            if time.monotonic() > deadline_s:
                raise
            time.sleep(0.05)


@dataclass(frozen=True)
class Latency:
    """Until the stop was sent and until it was seen at the drive (on CAN the same), s; requests of Modbus that it waited for."""

    left_s: float
    seen_s: float
    requests: int


def one_stop(rig: Rig, work: Callable[[ServoDrive], None], *, dead: bool, random: Random) -> Latency | None:
    """None where the work ended before the stop, or had an error and sent a stop of its own. Answers come again once the stop was
    seen: leaving is not measured."""
    _make_ready(rig)
    rig.seen.clear()
    pressed: list[float] = []
    over = threading.Event()

    def sent() -> list[float]:
        return [when for when in rig.seen if pressed and when >= pressed[0]]

    def press() -> None:
        time.sleep(random.uniform(0.05, 0.25))
        if dead:
            rig.dead(True)
            time.sleep(random.uniform(0.0, 0.05))
        pressed.append(time.monotonic())
        rig.stop.press()
        while dead and not sent() and not over.wait(0.001):
            pass
        rig.dead(False)

    presser = threading.Thread(target=press)
    presser.start()
    heard = False
    try:
        work(rig.drive)
    except StoppedByOperator:
        heard = True
    except BridgeError:  # a wait ended before the stop, or what failed while leaving is told instead of the stop
        heard = bool(sent())
    over.set()
    rig.drive.send_stop()
    presser.join()
    for order in (
        lambda: None,
        rig.drive.quick_stop,
    ):  # a stop destroyed on its way is sent again when it is confirmed
        deadline_s = time.monotonic() + SEEN_S
        with suppress(BridgeError):
            order()
        while not (after := sent()) and time.monotonic() < deadline_s:
            time.sleep(0.001)
        if after:
            break
    if not (heard and after) or rig.seen[0] < pressed[0]:
        return None
    seen_s = after[0] - pressed[0]
    return Latency(seen_s, seen_s, 0) if rig.wire is None else _of_modbus(rig.wire, pressed[0], seen_s)


def _of_modbus(wire: CountedWire, pressed_s: float, seen_s: float) -> Latency:
    left_s, requests = wire.before_stop(pressed_s)
    return Latency(left_s, seen_s, requests)


def wall_row(wire: str, name: str, *, dead: bool, moments: int) -> Row:
    random = Random(f"{wire} {name} {dead}")
    found: list[Latency] = []
    with WIRES[wire]() as rig:
        try:
            while len(found) < moments:
                latency = one_stop(rig, WORKS[name], dead=dead, random=random)
                found += [] if latency is None else [latency]
        finally:
            rig.dead(False)
            rig.stop.rearm()
            with suppress(BridgeError, StoppedByOperator):
                rig.drive.close()
    answers = ("SDO" if wire == "CANopen" else "answers") + (" dead" if dead else " alive")
    left, seen = sorted(each.left_s for each in found), sorted(each.seen_s for each in found)
    requests = None if wire == "CANopen" else max(each.requests for each in found)
    return Row(f"{wire}, {answers}", name, len(found), (left[len(left) // 2], left[-1], seen[-1]), requests)


def _busy() -> None:
    while True:
        pass


# -- the page ------------------------------------------------------------------------------------------------------------------
HEAD = f"""# How soon a stop leaves

The test presses the operator's stop at many moments of each job. The time runs from the press to the first frame that stops the
motion or switches the power off. On CAN at most {1e3 * BOUND_S:.0f} ms are allowed. On Modbus the frame waits only for the request
that is being answered.

`python tests/study/stop_latency.py --write` measures again, and writes the worst times here.

## In simulated time

The jobs are the verbs that move an axis. Simulated time moves in steps of 10 ms at most. "SDO dead": the drive answers no SDO
from 50 ms before the stop.

| wire | jobs | stops | worst | requests before the frame |
| --- | --- | --- | --- | --- |
"""
WALL_HEAD = """
## In real time, both cores loaded

The jobs are a move, a homing, a stream, and watching at rest, while two other processes compute. "Dead": answers are lost from up
to 50 ms before the stop. "At the drive" includes delays of the simulated drive's threads and of the pseudo-terminal.

| wire | jobs | stops | leaves, largest median | worst | at the drive, worst | requests before the frame |
| --- | --- | --- | --- | --- | --- | --- |
"""


def _simulated(args: argparse.Namespace) -> Iterator[Row]:
    with ProcessPoolExecutor(2) as pool:
        for face, sdo_dead in SIMULATED:
            for verb in VERBS:
                if args.verb is None or verb in args.verb:
                    yield simulated_row(face, sdo_dead, verb, args.moments, pool)


def _in_real_time(args: argparse.Namespace) -> Iterator[Row]:
    load = [multiprocessing.Process(target=_busy, daemon=True) for _ in range(2)]
    for process in load:
        process.start()
    try:
        for wire in args.wire or WIRES:
            for dead in (False, True):
                for name in WORKS:
                    if args.verb is None or name in args.verb:
                        yield wall_row(wire, name, dead=dead, moments=args.moments)
    finally:
        for process in load:
            process.terminate()
            process.join()


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--moments", type=int, default=200)
    parser.add_argument("--verb", action="append", choices=[*VERBS, *WORKS])
    parser.add_argument("--wire", action="append", choices=WIRES)
    parser.add_argument("--only", choices=("simulated", "wall"))
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name} as well; with --only that part of it")
    args = parser.parse_args(arguments)
    simulated, _, wall = PAGE.read_text(encoding="utf-8").partition(WALL_HEAD)
    parts = {"simulated": simulated, "wall": WALL_HEAD + wall}
    for part, head, measured in (("simulated", HEAD, _simulated(args)), ("wall", WALL_HEAD, _in_real_time(args))):
        if args.only in (None, part):
            rows = []
            for row in measured:
                rows.append(row)
                print(row.line(), flush=True)
            parts[part] = head + "".join(f"{row.line()}\n" for row in worst(rows))
    if args.write:
        PAGE.write_text(parts["simulated"] + parts["wall"], encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
