"""Every verb over every profile of a documented drive (`sim_backends/profiles`): works, refuses before motion, or neither.

Run by `python tests/study/makers_matrix.py --profiles`. Moves, runs and streams are those of `makers_matrix`; the other verbs are the
program's own, over the bench in simulated time. The true speed is that of the simulated shaft.
"""

from __future__ import annotations

import io
import json
import os
import re
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar
from unittest import mock

from study.makers_matrix import LEAD_MM, NODE, NOT_RESTORED, TOO_FAST, Row, Trial

from drivers.canopen.bus import CanLink
from drivers.canopen.scan import scan
from drivers.cia402.homing import HomingSettings
from drivers.drive import DriveState
from hil.app.main import main
from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key
from hil.machine import bench_canopen
from hil.ui.terminal import progress
from sim_backends import profile_paths
from sim_backends.bench import BenchParameters
from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.canopen_quirks import ProfiledSlave, machine_objects, profile_counts
from sim_backends.drive_profiles import DriveProfileFile, load_profile
from sim_backends.maker_file import MotionUnits
from sim_backends.servo import SimulatedServo


class ProfileTrial(Trial):
    """A profile instead of a maker's file: opens, enables, homes, moves, runs, streams."""

    def __init__(self, profile: DriveProfileFile) -> None:
        self.profile = profile
        super().__init__(profile.over())
        self.row.name = profile.name

    def steps(self) -> list[tuple[str, Callable[[], str]]]:
        return [*super().steps(), ("stops", self.stop), ("recovers", self.recover)]

    def stop(self) -> str:
        """A quick stop out of a move; the axis rests, is enabled anew and moves back."""
        drive = self.drive
        reach, speed = self.fits()
        start = drive.sample().position_load_mm
        drive.start_move(start + reach, speed)
        self._sample_for(0.25 * reach / speed)
        before = self.shaft_mm()
        drive.quick_stop()
        self._sample_for(1.0)
        place = self.shaft_mm()
        self._sample_for(0.5)
        if abs(self.shaft_mm() - place) > 0.01:
            return self._wrong("stops", "the axis moves on after the quick stop")
        drive.disable()
        drive.enable()
        self._go_to(start)
        return f"yes, {abs(place - before):.2f} mm"

    def recover(self) -> str:
        """A fault of the drive in rest, reset, enabled, moved."""
        drive = self.drive
        start = drive.sample().position_load_mm
        self.servo.raise_fault(0x8611)
        self._sample_for(0.1)
        if drive.sample().state is not DriveState.FAULT:
            return self._wrong("recovers", f"a fault is shown as {drive.sample().state.value}")
        drive.reset_fault()
        drive.enable()
        self._go_to(start + 1.0)
        self._go_to(start)
        return "yes"

    def _sample_for(self, seconds: float) -> None:
        for _ in range(round(100 * seconds)):
            self.drive.sample()
            self.clock.sleep_s(0.01)

    def _go_to(self, target_mm: float) -> None:
        self.drive.start_move(target_mm, self.fits()[1])
        self.drive.wait_for(lambda sample: sample.target_reached, 60.0, "there")

    def _wrong(self, column: str, what: str) -> str:
        self.row.failed = self.row.moved = True
        self.row.reasons.append(f"{column}: {what}")
        return "no"

    def kind_of_slave(self, servos: Sequence[SimulatedServo]) -> Callable[..., CanOpenSlave]:
        return partial(ProfiledSlave, profile=self.profile, lead_m=LEAD_MM / 1000)

    def factory_settings(self) -> dict[tuple[int, int], int]:
        return machine_objects(self.profile, BenchParameters())

    def stated(self, units: MotionUnits) -> dict[str, str | None]:
        return dict(self.profile.axis_file.drive)

    def homing_settings(self, axis: int) -> HomingSettings:
        usual = super().homing_settings(axis)
        method = self.profile.axis_file.homing_method
        return HomingSettings(method, usual.speed_switch_mm_s, usual.speed_zero_mm_s)


def trial_of(name: str) -> ProfileTrial:
    """The trial of a profile by its name."""
    return ProfileTrial(load_profile(name))


# -- the program's own verbs, over the bench in simulated time ---------------------------------------------------------------
AXIS_FILE = """
[axis]
name = "{name}"
travel_min_mm = -2.0
travel_max_mm = 502.0
max_velocity_mm_s = 100.0
max_acceleration_mm_s2 = 1000.0

[scaling]
encoder_counts_per_motor_rev = {counts}
feed_mm_per_shaft_rev = 10.0

[drive]
backend = "bench"
machine = "worn"
seed = {seed}
profile = "{profile}"
{drive}
[instrument]
place_temps = {{ screw = 4 }}

[measurement]
first_mm = 20.0
last_mm = 60.0
sections = 2
runs = 2
velocity_mm_s = 100.0
dwell_s = 0.1
reading_s = 0.1

[lost_motion]
places = 10
runs = 2
proof_moves = 12

[backlash]
reference_plus_mm = 5.0
reference_minus_mm = 5.0
travel_velocity_mm_s = 100.0
step_um = 8.0
settle_s = 0.03
readings = 1
velocity_mm_s = 2.0
run_in_mm = 0.2
"""
FASTEST_MM_S = 100.0
PASSWORDS = {"HIL_PASSWORD": "tables of the matrix", "HIL_KEY_PASSWORD": "builder of the matrix"}
VERBS: dict[str, tuple[str, ...]] = {
    "doctor": ("doctor", "X.toml"),
    "backup": ("params", "backup", "X.toml"),
    "download --dry-run": ("params", "download", "X.toml", "--set", "X.params.toml", "--dry-run"),
    "download": ("params", "download", "X.toml", "--set", "new.toml"),
    "calibrate": ("calibrate", "X.toml"),
    "verify": ("verify", "X.toml"),
    "backlash": ("backlash", "X.toml", "--runs", "1"),
    "lost-motion": ("lost-motion", "X.toml", "--only-measure"),
    "circle": (
        "circle",
        "X.toml",
        "Y.toml",
        "--uncorrected",
        "--feed",
        "600",
        "--radius",
        "10",
        "--centre",
        "40",
        "40",
    ),
    "close-loop": ("close-loop", "X.toml", "--runs", "2", "--rows", "12", "--warm-up", "0", "--person", "none"),
}
"""By column; one after the other in one folder, each on a fresh bench."""
CHANGED = (0x6085, 0)
"""Object that the download changes: the ramp of the quick stop."""


class Recorded(ProfiledSlave):
    """A profile's drive that is looked at from outside the program: true speed, and every object before and after."""

    seen: ClassVar[list[Recorded]] = []

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._last: tuple[int, float] | None = None
        self.fastest_mm_s = 0.0
        self.found: dict[tuple[int, int], bytes] = {}
        self.from_mm = self.shaft_mm
        Recorded.seen.append(self)

    @property
    def shaft_mm(self) -> float:
        return float(self.servo.motor_rev) * LEAD_MM  # type: ignore[attr-defined]

    def boot(self, now_ns: int) -> None:
        super().boot(now_ns)
        self.found = self.values()

    def values(self) -> dict[tuple[int, int], bytes]:
        od = self.dictionary
        changing = {place.key for place in self.switches.changing}
        return {
            key: od.raw(key)
            for key, item in od.items.items()
            if item.writable and key[0] not in NOT_RESTORED and key not in changing
        }

    def tick(self, now_ns: int) -> None:
        super().tick(now_ns)
        place = self.shaft_mm
        if self._last is not None and now_ns - self._last[0] >= 1_000_000:
            self.fastest_mm_s = max(self.fastest_mm_s, abs(place - self._last[1]) / ((now_ns - self._last[0]) * 1e-9))
        if self._last is None or now_ns - self._last[0] >= 1_000_000:
            self._last = (now_ns, place)

    def left_changed(self, allowed: Sequence[tuple[int, int]] = ()) -> list[str]:
        """What is not as it was found."""
        now = self.values()
        changed = [key for key, value in self.found.items() if now[key] != value and key not in allowed]
        left = [f"{i:04X}h:{s:02X} {self.found[i, s].hex()}→{now[i, s].hex()}" for i, s in changed]
        if self.servo.powered:
            left.append("under power")
        if self.nmt_state.name == "OPERATIONAL":
            left.append("operational")
        return left


@dataclass
class VerbRow:
    """What one profile could do with each verb. cells: by column: yes, not good, refused, or no."""

    name: str
    cells: dict[str, str] = field(default_factory=dict)
    reasons: list[str] = field(default_factory=list)
    fastest_mm_s: float = 0.0

    @property
    def good(self) -> bool:
        return "no" not in self.cells.values() and self.fastest_mm_s <= TOO_FAST * FASTEST_MM_S


def lay_out(folder: Path, profile: DriveProfileFile) -> None:
    """X.toml, Y.toml and the builder's keys."""
    bench = BenchParameters()
    drive = "".join(f"{key} = {json.dumps(value)}\n" for key, value in profile.axis_file.drive.items())
    homing = profile.axis_file.homing
    if homing:
        drive += "homing = { " + ", ".join(f"{key} = {value}" for key, value in homing.items()) + " }\n"
    counts = profile_counts(profile, bench)
    for name, seed in (("X", 5), ("Y", 6)):
        text = AXIS_FILE.format(name=name, counts=counts, seed=seed, profile=profile.name, drive=drive)
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    key = new_key()
    save_private_key(folder / "builder.key", key, PASSWORDS["HIL_KEY_PASSWORD"], cost=Cost(n=1 << 10, r=8, p=1))
    save_public_key(folder / "builder.pub", key.public_key())


def run_verbs(name: str, folder: Path, verbs: Sequence[str] = tuple(VERBS)) -> VerbRow:
    """Run verbs over a profile, each on a fresh bench; files and passwords in an empty folder."""
    profile, row = load_profile(name), VerbRow(name)
    lay_out(folder, profile)
    with mock.patch.object(bench_canopen, "ProfiledSlave", Recorded), mock.patch.dict(os.environ, PASSWORDS):
        for verb in verbs:
            Recorded.seen.clear()
            if verb == "download" and not change_set(folder):
                row.cells[verb] = row.cells["backup"]
                continue
            words = [str(folder / word) if word.endswith(".toml") else word for word in VERBS[verb]]
            out, err = io.StringIO(), io.StringIO()
            # what is told beside the result is no reason of its end
            told_aside = mock.patch.object(progress, "print", create=True)
            with redirect_stdout(out), redirect_stderr(err), told_aside:
                status = main(words)
            judge(row, verb, status, err.getvalue().strip(), out.getvalue())
    return row


def change_set(folder: Path) -> bool:
    """new.toml: the backup with another ramp of the quick stop, one that the drive takes. False without a backup."""
    if not (folder / "X.params.toml").exists():
        return False
    text = (folder / "X.params.toml").read_text(encoding="utf-8")

    def halved(found: re.Match[str]) -> str:
        value = int(found[2]) // 2 + 1
        return f"{found[1]}{value}, raw = {value}"

    changed = re.sub(r"(index = 0x6085, subindex = 0, value = )(\d+), raw = \d+", halved, text)
    edited = re.sub(r"(?m)^(\w*hash\w*|content) = .*\n", "", changed)  # of a set that was changed by hand
    (folder / "new.toml").write_text(edited, encoding="utf-8")
    return True


def judge(row: VerbRow, verb: str, status: int, error: str, out: str) -> None:
    """Fill in the cell of a verb."""
    slaves = list(Recorded.seen)
    moved = any(abs(slave.shaft_mm - slave.from_mm) > 0.01 or slave.fastest_mm_s > 0.1 for slave in slaves)
    left = [what for slave in slaves for what in slave.left_changed((CHANGED,) if verb == "download" else ())]
    row.fastest_mm_s = max([row.fastest_mm_s, *(slave.fastest_mm_s for slave in slaves)])
    last = error.splitlines()[-1] if error else (out.strip().splitlines() or [""])[-1]
    if left:
        cell = "no"
        row.reasons.append(f"{verb}: left {', '.join(left)}; {last}")
    elif status == 0:
        cell = "yes"
    elif not moved:
        cell = "refused"
        row.reasons.append(f"{verb}: {last}")
    else:
        cell = "not good" if status == 1 and not error else "no"
        row.reasons.append(f"{verb}: status {status}: {last}")
    row.cells[verb] = cell


# -- the table --------------------------------------------------------------------------------------------------------------
DRIVE_COLUMNS = ("opens", "enables", "homes", "moves", "streams", "stops", "recovers", "put back")
GOOD_CELLS = ("yes", "not good", "refused")


@dataclass
class ProfileRow:
    """A profile with all that was tried."""

    name: str
    drive: Row
    verbs: VerbRow
    scanned: str

    @property
    def cells(self) -> list[str]:
        """By column of `HEAD`."""
        return [
            self.name,
            self.scanned,
            *(self.drive.cells.get(column, "") for column in DRIVE_COLUMNS),
            *(self.verbs.cells.get(verb, "") for verb in VERBS),
            f"{100 * max(self.drive.worst, self.verbs.fastest_mm_s / FASTEST_MM_S):.0f} %",
        ]

    @property
    def reasons(self) -> list[str]:
        """Why something is not "yes"."""
        return [reason for reason in self.drive.reasons if reason.split(":")[0] in DRIVE_COLUMNS] + self.verbs.reasons

    @property
    def good(self) -> bool:
        """Works, or refuses before motion; nothing too fast, everything put back."""
        drive = self.drive
        return (
            (drive.works or drive.refused_safely)
            and drive.worst <= TOO_FAST
            and self.verbs.good
            and self.scanned == "yes"
        )


HEAD = ("profile", "scan", *DRIVE_COLUMNS, *VERBS, "fastest / asked")


def scanned(profile: DriveProfileFile) -> str:
    """Whether `hil scan` finds the drive, with its state, and changes nothing."""
    trial = ProfileTrial(profile)
    before = trial.values()
    with CanLink(trial.wire.port(), trial.clock) as link:
        found = [node for node in scan(link, (NODE,)) if node.answers_sdo and node.profile == 402]
    return "yes" if found and trial.values() == before else "no"


def study_profiles(names: Sequence[str], verbs: Sequence[str] = tuple(VERBS)) -> list[ProfileRow]:
    """All rows; names: of profiles, all without one."""
    rows = []
    for name in names or profile_paths():
        profile = load_profile(name)
        with TemporaryDirectory() as folder:
            row = ProfileRow(name, trial_of(name).run(), run_verbs(name, Path(folder), verbs), scanned(profile))
        rows.append(row)
    return rows


def profiles_markdown(rows: Sequence[ProfileRow]) -> str:
    """A table of what is not "yes": result, reason, steps or verbs, and the profiles; of most profiles, those that are excepted."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        reasons = {column: text for column, _, text in (reason.partition(": ") for reason in reversed(row.reasons))}
        for column, cell in zip(HEAD[1:-1], row.cells[1:-1], strict=True):
            if not cell.startswith("yes"):
                result = {"—": "not offered", "": "not tried"}.get(cell, cell)
                found.setdefault((result, _on_one_line(reasons.get(column, "")), column), []).append(row.name)
    merged: dict[tuple[str, str, tuple[str, ...]], list[str]] = {}
    for (result, reason, column), names in found.items():
        merged.setdefault((result, reason, tuple(names)), []).append(column)
    lines = ["| Not done | Result | Reason | Profiles |", "|---|---|---|---|"]
    for (result, reason, names), columns in merged.items():
        others = [row.name for row in rows if row.name not in names]
        are_most = 2 * len(names) > len(rows)
        who = ("all but " if are_most else "") + ", ".join(f"`{name}`" for name in (others if are_most else names))
        lines.append(f"| {', '.join(columns)} | {result} | {reason} | {who} |")
    return "\n".join(lines)


def _on_one_line(text: str) -> str:
    """A message without the folder of the run, the name of the axis and the exit status, which stands in the cell."""
    text = re.sub(r"\S*/tmp\w+/", "", " ".join(text.split())).removeprefix("status 1: ").replace("hil: ", "")
    return re.sub(r"^drive [^:]+?:? (?=homing|cannot)", "", text)


def profiles_summary(rows: Sequence[ProfileRow]) -> tuple[str, bool]:
    """One sentence, and whether nothing is neither of works and refused before motion."""
    cells = [row.verbs.cells[verb] for row in rows for verb in row.verbs.cells]
    neither = sum(cell not in GOOD_CELLS for cell in cells) + sum(not row.good for row in rows)
    worst = max((max(row.drive.worst, row.verbs.fastest_mm_s / FASTEST_MM_S) for row in rows), default=0.0)
    text = (
        f"{len(rows)} profiles, {len(cells)} runs of verbs: {cells.count('yes')} done, {cells.count('not good')} ended with their"
        f" verdict, {cells.count('refused')} refused before motion, {neither} neither; largest true speed {100 * worst:.0f} %"
    )
    return text, neither == 0
