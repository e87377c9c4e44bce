"""`hil scan` and `hil doctor` on a bus that others fill: they end within 10 s beyond what they take on a quiet line.

In simulated time, on a bus at 125 or 250 kbit/s that is asked for more frames than it can carry. A flood that outranks the master's
requests starves them: then the end is an error, or nobody found, in the same time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from support import bench_axis
from support.can_bench import CanBench, attach_to_wire
from support.can_wire import SimWire
from support.sdo_peers import Flood

from drivers.canopen.bus import CanLink
from drivers.canopen.scan import FoundNode, listen, scan
from drivers.errors import BridgeError
from hil.axis.axis_file import load_axis
from hil.doctor.procedure import Check, doctor
from hil.machine.bench_wiring import bench_parameters
from hil.machine.canopen_wiring import canopen_drive
from hil.machine.instruments import build_instrument
from hil.machine.links import Links
from hil.machine.machine import session_of
from hil.machine.session import AxisSession
from sim_backends.bench import Bench

pytestmark = pytest.mark.outside

BEYOND_S = 10.0
NODES = (2, 5, 127)
NODE = 5
DEVICE_TYPE = b"\x43\x00\x10\x00\x92\x01\x02\x00"
NUMBER = b"\x43\x18\x10\x01\x01\x00\x00\x00"
SEGMENT = b"\x00abcdefg"

FLOODS: dict[str, list[tuple[int, bytes]]] = {
    "heartbeats": [(0x700 + node, b"\x05") for node in range(1, 128)],
    "boot-ups": [(0x700 + NODE, b"\x00")],
    "emergencies": [(0x080 + node, b"\x10\x81\x11\0\0\0\0\0") for node in range(1, 128)],
    "emergencies of the node": [(0x080 + NODE, b"\x10\x81\x11\0\0\0\0\0")],
    "PDOs": [(base + node, bytes(8)) for base in (0x180, 0x280, 0x380, 0x480) for node in range(1, 33)],
    "PDOs of the node": [(0x480 + NODE, bytes(8))],
    "SDO answers of everybody": [(0x580 + node, DEVICE_TYPE) for node in range(1, 128)],
    "SDO answers of other nodes": [(0x580 + node, DEVICE_TYPE) for node in range(1, 128) if node not in NODES],
    "SDO answers of the node": [(0x580 + NODE, data) for data in (DEVICE_TYPE, NUMBER, SEGMENT)],
    "SDO aborts of the node": [(0x580 + NODE, b"\x80\x00\x10\x00\x00\x00\x02\x06")],
    "everything": [
        (cob_id, data)
        for node in range(1, 128)
        for cob_id, data in (
            (0x080 + node, bytes(8)),
            (0x180 + node, bytes(8)),
            (0x580 + node, NUMBER),
            (0x700 + node, b"\x7f"),
        )
    ],
}
"""Named for what they are; each is sent without a pause."""
FULL_S = 0.0003  # between two frames: at 125 kbit/s a frame without data takes 0.38 ms


def seconds(clock_ns: Callable[[], int], work: Callable[[], object]) -> tuple[float, object]:
    start_ns = clock_ns()
    try:
        came: object = work()
    except BridgeError as error:
        came = error
    return (clock_ns() - start_ns) * 1e-9, came


def scanned(*floods: tuple[list[tuple[int, bytes]], float]) -> tuple[float, object]:
    bench = CanBench(NODES, 125_000)
    bench.clock.sleep_s(0.1)
    for frames, period_s in floods:
        Flood(bench.wire, frames, period_s)
    with CanLink(bench.port(), bench.clock) as link:
        return seconds(bench.clock.now_ns, lambda: scan(link))


@pytest.mark.parametrize("name", FLOODS)
def test_a_scan_ends_in_time(name: str) -> None:
    quiet_s, found = scanned()
    assert isinstance(found, list)
    assert [node.node_id for node in found] == list(NODES)
    took_s, came = scanned((FLOODS[name], FULL_S))
    assert took_s <= quiet_s + BEYOND_S
    assert isinstance(came, list)


@pytest.mark.parametrize("name", [name for name in FLOODS if "everybody" not in name and name != "everything"])
def test_a_scan_finds_the_nodes_of_a_bus_that_is_half_full(name: str) -> None:
    took_s, came = scanned((FLOODS[name], 0.002))
    assert took_s <= scanned()[0] + BEYOND_S
    assert isinstance(came, list)
    answering = [node for node in came if isinstance(node, FoundNode) and node.answers_sdo]
    assert {node.node_id for node in answering} >= set(NODES)


def test_listening_takes_its_time_and_no_more() -> None:
    bench = CanBench(NODES, 125_000)
    Flood(bench.wire, FLOODS["everything"], FULL_S)
    with CanLink(bench.port(), bench.clock) as link:
        took_s, _ = seconds(bench.clock.now_ns, lambda: listen(link, 2.0))
    assert took_s == pytest.approx(2.0, abs=0.01)


# -- doctor --------------------------------------------------------------------------------------------------------------
@contextmanager
def on_wire(folder: Path, flood: list[tuple[int, bytes]], period_s: float, start_s: float) -> Iterator[AxisSession]:
    """The bench's axis behind a CAN bus that somebody fills from `start_s` on."""
    axis = load_axis(bench_axis.lay_out(folder))
    with ExitStack() as stack:
        bench = stack.enter_context(Bench(bench_parameters(axis)))
        wire = SimWire(bench.clock, 250_000)
        attach_to_wire(wire, bench.servo, axis.drive.node_id, parameters=bench.parameters.objects)
        bench.clock.sleep_s(0.1)
        if flood:
            frames = [
                (cob_id - NODE + axis.drive.node_id if cob_id & 0x7F == NODE else cob_id, data)
                for cob_id, data in flood
            ]
            Flood(wire, frames, period_s, start_s=start_s)
        link = stack.enter_context(CanLink(wire.port(), bench.clock))
        drive = canopen_drive(
            axis, bench.clock, ("simulated", "wire"), stack, links=Links({("simulated", "wire"): link})
        )
        instrument = build_instrument(axis.instrument, bench.laser_path, bench.clock)
        yield session_of(axis, drive, instrument, None)


def examined(
    folder: Path, flood: list[tuple[int, bytes]], period_s: float = 0.0, start_s: float = 0.0
) -> tuple[float, object]:
    with on_wire(folder, flood, period_s, start_s) as session:

        def work() -> list[Check]:
            with session:
                return doctor(session)

        return seconds(session.clock.now_ns, work)


@pytest.fixture(scope="module")
def quiet_s(tmp_path_factory: pytest.TempPathFactory) -> float:
    took_s, came = examined(tmp_path_factory.mktemp("quiet"), [])
    assert isinstance(came, list)
    assert all(check.good for check in came)
    return took_s


@pytest.mark.parametrize(("name", "start_s"), [(name, 3.0 * (turn % 2)) for turn, name in enumerate(FLOODS)])
def test_doctor_ends_in_time(name: str, start_s: float, quiet_s: float, tmp_path: Path) -> None:
    took_s, came = examined(tmp_path, FLOODS[name], FULL_S / 2, start_s)
    assert took_s <= quiet_s + BEYOND_S
    assert isinstance(came, list | BridgeError)
