"""Every maker's dictionary with a controlword, against a strict slave made from the file alone: opens, enables, homes, moves, streams.

    python tests/study/makers_matrix.py [NAME …]      those whose file name holds NAME; all without one
    python tests/study/makers_matrix.py --markdown    the table of hil/docs/drives_tested.md, which has the refusals in a sentence
    python tests/study/makers_matrix.py --profiles    every verb over every profile of a documented drive (`profiles_matrix`)

The files are looked for in HIL_SHARED_DATA/eds, else ../shared/data/eds. A user's axis file is played: the counts per revolution
and the lead of the machine are right, and velocity_unit is stated where the maker's manual states it and no object does (`STATED`).
Speed is the true speed of the slave's shaft. Exit status 1 unless 90 % of the dictionaries work, the others refuse before motion,
no speed was exceeded by 5 % and every object was put back.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from support.can_bench import attach_to_wire
from support.can_wire import SimWire

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.settings import CanOpenSettings
from drivers.cia402.homing import HomingSettings
from drivers.drive import Capability
from drivers.errors import BridgeError, CapabilityError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from sim_backends.bare_shaft import BareShaft
from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.canopen_strict import StrictSlave
from sim_backends.clock import SimClock
from sim_backends.homing import HOMING_METHODS
from sim_backends.maker_file import TECHNOSOFT, TRINAMIC, MakerFile, MotionUnits, number_in, read_maker_file
from sim_backends.servo import ServoParameters, SimulatedServo

NODE = 5
LEAD_MM = 10.0
SPEED_MM_S, HOMING_MM_S = 10.0, 5.0
TOO_FAST, RIGHT = 1.05, 0.01
SERVO_COUNTS = 8_000_000
STATED = {TRINAMIC: "rpm", TECHNOSOFT: "1/65536 counts/ms"}
"""velocity_unit of the axis file where the maker's manual states it and no object does."""
NOT_RESTORED = {0x6040, 0x607A, 0x60FF, 0x6071, 0x60C1, 0x60B0, 0x60B1, 0x60B2, 0x1003}
"""Commands and targets: never put back, as they would be motion orders."""
SERVO = ServoParameters(
    counts_per_rev=SERVO_COUNTS,
    negative_limit_counts=-3.0 * SERVO_COUNTS,
    positive_limit_counts=40.0 * SERVO_COUNTS,
    negative_stop_counts=-5.0 * SERVO_COUNTS,
    positive_stop_counts=45.0 * SERVO_COUNTS,
    home_switch_counts=-2.0 * SERVO_COUNTS,
)


@dataclass
class Row:
    """What one dictionary could do. cells: by column; reasons: what was refused or said."""

    name: str
    files: int = 1
    cells: dict[str, str] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)
    worst: float = 0.0  # largest true speed over the asked one
    moved: bool = False  # when it refused
    failed: bool = False
    not_restored: list[str] = field(default_factory=list)

    @property
    def works(self) -> bool:
        return not self.failed and self.cells.get("moves", "").startswith("yes") and not self.not_restored

    @property
    def refused_safely(self) -> bool:
        return self.failed and not self.moved and not self.not_restored


WORDS = {"0X6", "0X06", "0X0006", "6", "UNSIGNED16", "0X3", "0X03", "0X0003", "3"}
"""Data types of a controlword: UNSIGNED16, and INTEGER16 as two files have it."""
COLUMNS = ("opens", "enables", "homes", "moves", "streams", "put back")


def signature(maker: MakerFile) -> tuple[object, ...]:
    """What makes two files one dictionary: objects, types, rights, limits, defaults; not the values of one user."""
    names = ("datatype", "accesstype", "lowlimit", "highlimit", "defaultvalue", "pdomapping")
    return tuple(sorted((key, *(entry.get(name, "").lower() for name in names)) for key, entry in maker.texts.items()))


def dictionaries(folder: Path) -> list[tuple[MakerFile, int]]:
    """The different dictionaries with a controlword, each with the number of files that hold it."""
    found: dict[tuple[object, ...], MakerFile] = {}
    count: Counter[tuple[object, ...]] = Counter()
    for path in sorted([*folder.glob("*.eds"), *folder.glob("*.dcf")]):
        try:
            maker = read_maker_file(path)
        except BridgeError:
            continue
        if maker.texts.get((0x6040, 0), {}).get("datatype", "").upper() not in WORDS:
            continue  # 6040h of another profile, or none
        key = signature(maker)
        found.setdefault(key, maker)
        count[key] += 1
    return [(maker, count[key]) for key, maker in found.items()]


def homing_method(maker: MakerFile) -> int:
    """A method that the file allows: the negative limit switch where it may be chosen, else the default, else the present position."""
    entry = maker.texts.get((0x6098, 0), {})
    low, high = number_in(entry.get("lowlimit", "")), number_in(entry.get("highlimit", ""))
    default = maker.number(0x6098) or 0
    for method in (17, default, 35, 37):
        if (
            method in HOMING_METHODS
            and (low is None or low > 127 or low <= method)
            and (high is None or method <= high)
        ):
            return method
    return 35


@dataclass
class SpeedWatch:
    """The true speed of a shaft in rev/s, by the places it was at. fastest: since `restart`. path: (time ns, rev) of every step."""

    servo: SimulatedServo
    fastest_rev_s: float = 0.0

    def __post_init__(self) -> None:
        self._rev = self.servo.motor_rev
        self.now_rev_s = 0.0

    def restart(self) -> None:
        """Forget what was seen."""
        self.fastest_rev_s = 0.0

    def advance(self, _now_ns: int, dt_s: float) -> None:
        """For `SimClock.attach`, behind the servo."""
        rev = self.servo.motor_rev
        self.now_rev_s = (rev - self._rev) / dt_s
        self._rev = rev
        self.fastest_rev_s = max(self.fastest_rev_s, abs(self.now_rev_s))


class Trial:
    """One dictionary: the slave, the drive, and what is tried with it."""

    def __init__(self, maker: MakerFile, axis: int = 1) -> None:
        self.maker = maker
        self.row = Row(f"{(maker.product or maker.path.stem)[:26]}" + (f" axis {axis}" if axis > 1 else ""))
        self.clock = SimClock()
        servos = []
        for _ in range(max(1, maker.axes)):
            servo = SimulatedServo(BareShaft(), SERVO)
            self.clock.attach(servo.advance, bearable=servo.bearable)
            servos.append(servo)
        self.servo = servos[axis - 1]
        self.watch = SpeedWatch(self.servo)
        self.clock.attach(self.watch.advance, bearable=lambda _now: 10_000_000_000)
        wire = self.wire = SimWire(self.clock)
        slave = attach_to_wire(
            wire, servos[0], NODE, make=self.kind_of_slave(servos), parameters=self.factory_settings()
        )
        assert isinstance(slave, StrictSlave)
        self.slave = slave
        self.units = units = slave.units[axis - 1]
        settings = {
            "homing": self.homing_settings(axis),
            "heartbeat_s": 0.2,
            "guard_s": 0.5,
            **self.stated(units),
            "axis": axis,
        }
        known = {one.name for one in dataclasses.fields(CanOpenSettings)}
        self.drive = CanOpenDrive(
            self.row.name,
            AxisScaling(max(1, round(1 / units.position_rev)), LEAD_MM),
            DriveLimits(-100.0, 300.0, 50.0, 100.0),
            self.clock,
            link=CanLink(wire.port(), self.clock),
            node_id=NODE,
            settings=CanOpenSettings(**{key: value for key, value in settings.items() if key in known}),  # type: ignore[arg-type]
        )

    def kind_of_slave(self, servos: Sequence[SimulatedServo]) -> Callable[..., CanOpenSlave]:
        """What makes the slave of the first of these servos."""
        return partial(StrictSlave, maker=self.maker, servos=servos[1:], lead_m=LEAD_MM / 1000)

    def factory_settings(self) -> dict[tuple[int, int], int] | None:
        """Values laid over those of the file."""
        return None

    def stated(self, units: MotionUnits) -> dict[str, str | None]:
        """Units that the axis file states."""
        known = units.source.startswith(("60A9h", "608Ch"))
        return {"velocity_unit": None if known else STATED.get(self.maker.vendor)}

    def homing_settings(self, axis: int) -> HomingSettings:
        """As a user sets them who has read the manual: what cannot be chosen is left to the drive."""
        offset, items = 0x800 * (axis - 1), self.slave.dictionary.items
        chosen = (0x6098 + offset, 0) in items and items[0x6098 + offset, 0].writable
        speeds = [HOMING_MM_S / number if (0x6099 + offset, sub) in items else None for sub, number in ((1, 1), (2, 5))]
        return HomingSettings(homing_method(self.maker) if chosen else None, *speeds)

    def fits(self) -> tuple[float, float]:
        """Distance, mm, and velocity, mm/s, of the moves: within the software limits and the largest ramp of the file."""
        units, found = self.units, self.slave.dictionary.items
        reach = 20.0
        for index, sub in ((0x607D, 2), (0x607A, 0)):
            item = found.get((index, sub))
            limit = self.maker.number(index, sub) if index == 0x607D else None if item is None else item.high
            if limit is not None and limit > 0:
                reach = min(reach, 0.9 * limit * units.position_rev * LEAD_MM)
        ramp = 100.0
        for index in (0x60C5, 0x60C6):
            value = self.maker.number(index) or 0
            if value > 0:
                ramp = min(ramp, value * units.acceleration_rev_s2 * LEAD_MM)
        self.ramp_mm_s2 = ramp
        return reach, min(SPEED_MM_S, 0.5 * math.sqrt(ramp * reach))

    def values(self) -> dict[tuple[int, int], bytes]:
        od = self.slave.dictionary
        return {
            key: od.raw(key)
            for key, item in od.items.items()
            if item.writable and not {key[0], key[0] - (key[0] - 0x6000) // 0x800 * 0x800} & NOT_RESTORED
        }

    def shaft_mm(self) -> float:
        return self.servo.motor_rev * LEAD_MM

    def steps(self) -> list[tuple[str, Callable[[], str]]]:
        """What is tried, in order, by column."""
        return [
            ("opens", self.open),
            ("enables", self.enable),
            ("homes", self.home),
            ("moves", self.move),
            ("streams", self.stream),
        ]

    def run(self) -> Row:
        row, before = self.row, self.values()
        place = self.shaft_mm()
        for name, step in self.steps():
            try:
                row.cells[name] = step()
            except BridgeError as error:
                row.cells[name] = "no"
                row.reasons.append(f"{name}: {error}")
                row.failed = True
                row.moved = abs(self.shaft_mm() - place) > 0.01
                break
        try:
            if self.drive._open:
                self.drive.disable()
            self.drive.close()
        except BridgeError as error:
            row.reasons.append(f"closes: {error}")
            row.failed = True
        row.reasons[:0] = [note.removeprefix(f"drive {row.name}").strip(" :") for note in self.drive.notes]
        after = self.values()
        row.not_restored = [
            f"{k[0]:04X}h:{k[1]:02X} {before[k].hex()}→{after[k].hex()}" for k in before if before[k] != after[k]
        ]
        if self.slave.nmt_state.name == "OPERATIONAL":
            row.not_restored.append("left operational")
        if self.servo.powered:
            row.not_restored.append("left under power")
        row.cells["put back"] = "yes" if not row.not_restored else "no"
        return row

    # -- the steps -------------------------------------------------------------------------------------------------------
    def open(self) -> str:
        self.drive.open()
        return "yes"

    def enable(self) -> str:
        self.drive.enable()
        return "yes"

    def judge_speed(self, asked_mm_s: float, seen_rev_s: float) -> None:
        share = seen_rev_s * LEAD_MM / asked_mm_s
        self.row.worst = max(self.row.worst, share)

    def home(self) -> str:
        if Capability.HOMING not in self.drive.capabilities:
            return "—"
        self.watch.restart()
        try:
            self.drive.home(60.0)
        finally:
            self.judge_speed(HOMING_MM_S, self.watch.fastest_rev_s)
        share = self.watch.fastest_rev_s * LEAD_MM / HOMING_MM_S
        return f"yes ({self.drive.settings.homing.method})" + ("" if share < 1 + RIGHT else f" {100 * share:.0f} %")

    def move(self) -> str:
        drive = self.drive
        start = drive.sample().position_load_mm
        frame = self.shaft_mm() - start
        worst = 0.0
        reach, speed = self.fits()
        for target in (start + reach, start + 0.1 * reach):
            self.watch.restart()
            speeds: list[float] = []
            drive.start_move(target, speed)
            deadline = self.clock.deadline(200.0)
            try:
                while not (sample := drive.sample()).target_reached:
                    speeds.append(abs(self.watch.now_rev_s) * LEAD_MM)
                    if deadline.expired:
                        raise StopIteration
                    self.clock.sleep_s(0.01)
            except StopIteration:
                self.row.failed = self.row.moved = True
                self.row.reasons.append(
                    f"moves: {target - start:g} mm not reached in 60 s, it is at {sample.position_load_mm - start:.3f}"
                )
                return "no"
            finally:
                self.judge_speed(speed, self.watch.fastest_rev_s)
            plateau = sorted(speeds)[len(speeds) // 2]
            worst = max(worst, abs(plateau / speed - 1.0), key=abs)
            if abs(self.shaft_mm() - frame - target) > 0.05:
                self.row.failed = self.row.moved = True
                self.row.reasons.append(f"moves: arrived {self.shaft_mm() - frame - target:.3f} mm from the target")
                return "no"
        if worst > RIGHT:
            self.row.failed = self.row.moved = True
            self.row.reasons.append(f"moves: true speed {100 * worst:.1f} % off")
            return "wrong speed"
        return f"yes, {100 * worst:.1f} %"

    def stream(self) -> str:
        drive = self.drive
        if Capability.STREAMING not in drive.capabilities:
            return "—"
        start, period_s = drive.sample().position_load_mm, 0.010
        self.watch.restart()
        reach = 1.0
        frame = self.shaft_mm() - start
        places: list[float] = []
        try:
            with drive.stream(SetPointSettings(period_s=period_s)) as stream:
                for number in range(300):
                    phase = min(1.0, number / 250)
                    stream.cycle([start + reach * (1 - math.cos(math.tau * phase))])
                    places.append(self.shaft_mm())
        except CapabilityError as error:
            self.row.reasons.append(f"streams: {error}")
            return "no"
        error = self.shaft_mm() - frame - start
        fastest = reach * math.tau / (250 * period_s)
        # over ten cycles: a set-point is a whole number of counts
        seen = max(abs(later - earlier) for earlier, later in zip(places, places[10:], strict=False)) / (10 * period_s)
        self.judge_speed(fastest, seen / LEAD_MM)
        if abs(error) > 0.05:
            self.row.failed = self.row.moved = True
            self.row.reasons.append(f"streams: {error:.3f} mm off at the end")
            return "no"
        return "yes"


def shared_data() -> Path | None:
    """The folder of the makers' files; None where it is absent."""
    for place in (os.environ.get("HIL_SHARED_DATA"), Path(__file__).parents[2] / "../shared/data"):
        if place and (Path(place) / "eds").is_dir():
            return Path(place) / "eds"
    return None


def study(folder: Path, names: list[str]) -> list[Row]:
    """All rows; names: parts of file names, all files without one."""
    rows = []
    for maker, files in dictionaries(folder):
        if names and not any(name.lower() in maker.path.name.lower() for name in names):
            continue
        for axis in range(1, min(2, maker.axes) + 1):
            trial = Trial(maker, axis)
            row = trial.run()
            row.files = files
            rows.append(row)
    return rows


def shown(rows: list[Row]) -> str:
    """The rows with what was said of each, for a terminal."""
    lines = []
    for row in rows:
        cells = [row.name, *(row.cells.get(name, "") for name in COLUMNS)]
        lines.append(" | ".join(f"{cell:<12}" for cell in cells) + (" works" if row.works else ""))
        lines += [f"      {reason}" for reason in (*row.reasons, *row.not_restored)]
    return "\n".join(lines)


def markdown(rows: list[Row]) -> str:
    """What was done, and the dictionaries that did it: a table by outcome. Equal names are one with their number."""
    by_outcome: dict[str, Counter[str]] = {}
    for row in rows:
        by_outcome.setdefault(outcome(row), Counter())[row.name.replace("|", "")] += 1
    lines = ["| Done, or refused because | Number | Dictionaries |", "|---|---|---|"]
    for what in sorted(by_outcome, key=lambda each: (each.startswith("refused"), each)):
        names = by_outcome[what]
        shown_names = (name + (f" ×{number}" if number > 1 else "") for name, number in sorted(names.items()))
        lines.append(f"| {what} | {names.total()} | {', '.join(shown_names)} |")
    return "\n".join(lines)


def outcome(row: Row) -> str:
    """The steps that were done, or why the drive was refused; and whether it was not put back."""
    if row.failed:
        what = "refused" if row.refused_safely else "failed"
        done = f"{what}: {next((reason for reason in row.reasons if reason.split(':')[0] in COLUMNS), 'no reason')}"
    else:
        done = ", ".join(step for step in ("homes", "moves", "streams") if row.cells.get(step, "").startswith("yes"))
    return done + (", not put back" if row.not_restored else "")


def summary(rows: list[Row]) -> tuple[str, bool]:
    work = sum(row.works for row in rows)
    refused = sum(row.refused_safely for row in rows)
    worst = max((row.worst for row in rows), default=0.0)
    restored = sum(not row.not_restored for row in rows)
    good = work >= 0.9 * len(rows) and work + refused == len(rows) and worst <= TOO_FAST and restored == len(rows)
    text = (
        f"{len(rows)} dictionaries and axes: {work} work, {refused} refuse before motion, {len(rows) - work - refused} neither;"
        f" {restored} put back object by object; largest true speed {100 * worst:.0f} % of the asked one"
    )
    return text, good


def profiles(names: list[str]) -> int:
    """Every verb over the profiles, as markdown."""
    from study.profiles_matrix import profiles_markdown, profiles_summary, study_profiles  # noqa: PLC0415  it uses this module

    found = study_profiles(names)
    text, good = profiles_summary(found)
    print(f"{profiles_markdown(found)}\n\n{text}")
    return 0 if good else 1


def main() -> int:
    parser = argparse.ArgumentParser(description="The matrix of makers' dictionaries.")
    parser.add_argument("names", nargs="*")
    parser.add_argument("--markdown", action="store_true")
    parser.add_argument(
        "--profiles", action="store_true", help="profiles of documented drives instead of makers' files"
    )
    args = parser.parse_args()
    if args.profiles:
        return profiles(args.names)
    folder = shared_data()
    if folder is None:
        print("no makers' files: set HIL_SHARED_DATA", file=sys.stderr)
        return 2
    rows = study(folder, args.names)
    print(markdown(rows) if args.markdown else shown(rows))
    text, good = summary(rows)
    print(f"\n{text}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
