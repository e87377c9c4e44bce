"""The table of Modbus families: every shipped map of a maker's drive against a drive made from notes, under a foreign Modbus stack.

PYTHONPATH=.:tests python -m study.modbus_families        prints the table of hil/docs/drives_tested.md, "Modbus"
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from support.maker_drives import FAMILIES, MakerDrive, MakerWire, served, served_on_a_line

from drivers.drive import DriveState
from drivers.instrument import DistanceInstrument, Environment, Reading, ReadingStatus
from drivers.limits import DriveLimits
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.drive_map import DriveMap
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.wire import Wire
from drivers.scaling import AxisScaling
from hil.axis.axis_file import MeasurementConfig
from hil.doctor.procedure import Check
from sim_backends.clock import SimClock

LIMITS = DriveLimits(-300.0, 300.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
FEED_MM = 10.0
SPEED_MM_S = 50.0  # 300 rpm, a whole number in every family's unit
TARGET_MM, TIMEOUT_S = 60.0, 10.0

HOW = MeasurementConfig(targets_mm=(5.0, 50.0), velocity_mm_s=50.0, reference_mm=5.0, home=False, reading_s=0.1)


@dataclass
class Rig:
    drive: ModbusDrive
    maker: MakerDrive
    clock: SimClock

    def true_mm(self) -> float:
        return self.maker.servo.position_actual_counts * FEED_MM / self.maker.counts_per_rev


@contextmanager
def family(
    name: str,
    *,
    map_path: Path | None = None,
    maker: type[MakerDrive] | None = None,
    scaling: AxisScaling | None = None,
    stack: str = "",
) -> Iterator[Rig]:
    """A drive of a family and the driver that its map makes, not open.

    stack: "pyModbusTCP" on loopback, "umodbus" on a serial line; by default no frames, each request goes to the drive's memory.
    """
    clock = SimClock()
    made = (maker or FAMILIES[name])(clock)
    drive_map = load_drive_map(map_path or name)
    with _place(made, drive_map, stack) as (endpoint, make_wire):
        link = ModbusLink(endpoint, clock, make_wire=make_wire)
        drive = ModbusDrive(
            "X",
            scaling or AxisScaling(made.counts_per_rev, FEED_MM),
            LIMITS,
            clock,
            link=link,
            unit=1,
            drive_map=drive_map,
        )
        yield Rig(drive, made, clock)


@contextmanager
def _place(
    made: MakerDrive, drive_map: DriveMap, stack: str
) -> Iterator[tuple[Endpoint, Callable[[Endpoint], Wire] | None]]:
    bus = drive_map.registers.bus
    if stack == "umodbus":
        with served_on_a_line(made, bus.baud) as (port, _):
            yield RtuEndpoint(port, bus.baud, "N", bus.stop_bits, TIMEOUT_S), None  # a pseudo-terminal refuses a parity
    elif stack == "pyModbusTCP":
        with served(made) as tcp:
            yield TcpEndpoint("127.0.0.1", tcp, TIMEOUT_S), None
    else:
        yield TcpEndpoint("127.0.0.1", 0, TIMEOUT_S), lambda _endpoint: MakerWire(made)


class Scale(DistanceInstrument):
    """Reads the servo's true position every 10 ms."""

    name = "scale"

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._count = 0
        self._next_ns = 0

    def open(self) -> None: ...

    def close(self) -> None: ...

    def poll(self) -> Sequence[Reading]:
        now_ns = self._rig.clock.now_ns()
        if now_ns < self._next_ns:
            return ()
        self._next_ns, self._count = now_ns + 10_000_000, self._count + 1
        return (Reading(now_ns, ReadingStatus.GOOD, self._rig.true_mm(), self._count),)

    def environment(self) -> Environment:
        return Environment(self._rig.clock.now_ns())

    @property
    def sample_rate_hz(self) -> float | None:
        return 100.0


def failures(checks: list[Check]) -> str:
    return "; ".join(f"{check.name}: {check.detail}" for check in checks if not check.good)


@dataclass
class Result:
    """What one family did. speed and distance: error against what was asked, percent and mm; stop_mm: travel from the stop to rest."""

    name: str
    weak: int = 0
    homing: str = ""
    speed_percent: float = 0.0
    distance_mm: float = 0.0
    stop_mm: float = 0.0
    changed: tuple[str, ...] = ()


def exercise(name: str, stack: str = "pyModbusTCP") -> Result:
    """Open, enable, home, move, quick stop, disable, close. Raises what the drive raises."""
    result = Result(name)
    with family(name, stack=stack) as rig:
        drive, maker = rig.drive, rig.maker
        result.weak = sum(len(each) for each in drive.map.weak().values())
        with drive.proving(), drive:
            drive.enable()
            if drive.map.homing is None:
                result.homing = drive.map.without_homing.split(";")[0]
            else:
                drive.start_homing()
                drive.wait_for(lambda sample: bool(sample.homed), 60.0, "homed")
                result.homing = "yes"
            start = 20.0
            _go(rig, start, 100.0)
            maker.fastest_counts_s = 0.0
            before = maker.servo.position_actual_counts
            _go(rig, TARGET_MM, SPEED_MM_S)
            per_mm = maker.counts_per_rev / FEED_MM
            result.speed_percent = 100.0 * (maker.fastest_counts_s / per_mm / SPEED_MM_S - 1.0)
            result.distance_mm = (maker.servo.position_actual_counts - before) / per_mm - (TARGET_MM - start)
            drive.start_move(200.0, SPEED_MM_S)
            rig.clock.sleep_s(0.5)
            at_stop = rig.true_mm()
            drive.quick_stop()
            rig.clock.sleep_s(0.5)
            result.stop_mm = rig.true_mm() - at_stop
            drive.disable()
            assert drive.sample().state is not DriveState.ENABLED
            assert not maker.servo.powered
        after = maker.memory()
        result.changed = tuple(f"{address:#06x}" for address, value in maker.found.items() if after[address] != value)
    return result


def _go(rig: Rig, position_mm: float, velocity_mm_s: float) -> None:
    rig.drive.start_move(position_mm, velocity_mm_s)
    rig.drive.wait_for(lambda sample: sample.target_reached, 30.0, "arrived")


def table(results: list[Result]) -> str:
    """Markdown rows, one per family; then the largest errors, and the registers that were left changed."""
    lines = ["| Drive file | Facts to prove | Homes | Quick stop within, mm |", "|---|---|---|---|"]
    for each in results:
        homes = "yes" if each.homing == "yes" else "no"
        lines.append(f"| `{each.name}` | {each.weak} | {homes} | {each.stop_mm:.2f} |")
    speed = max(abs(each.speed_percent) for each in results)
    distance = max(abs(each.distance_mm) for each in results)
    changed = "; ".join(f"`{each.name}` {', '.join(each.changed)}" for each in results if each.changed)
    lines += ["", f"The speed was wrong by {speed:.2f} % at most, the distance by {1000 * distance:.1f} µm."]
    lines += [f"Registers that stay changed: {changed or 'none'}."]
    return "\n".join(lines)


def main() -> None:
    print(table([exercise(name) for name in FAMILIES]))


if __name__ == "__main__":
    main()
