"""The contents of the page of system D: contacts as they are measured, the run-out, the values in force, and the
history.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import TypeVar

from drivers.errors import InputError
from hil.desk.desk import Desk
from hil.desk.progress import Progress
from hil.machine.events import Measured
from hil.probe import job as probe
from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.procedure import RunOutMeasurement, contact_name
from hil.probe.runout import ANGLES_DEG, FourFeeds, RunOut, run_out_std_um
from hil.probe.store import RunOutStore
from hil.records.rows import UM_PER_MM

JobResult = TypeVar("JobResult")
Points = list[tuple[float, float]]
KINDS = (probe.MEASURE, probe.CORRECT, probe.CENTRE, probe.OTHER)
SHOWN = 200
"""Most measurements of the history that are shown, the latest."""
UNITS, MOST_OF_A_UNIT = {"minutes": 60.0, "hours": 3600.0, "days": 86_400.0}, 100
STORED, REFUSED, BROKEN_OFF = "stored", "refused", "broken off"


# -- jobs: one machine, whichever axis's page it was started from --------------------------------------------------------------
def last_at(desks: Iterable[Desk], kinds: Iterable[str] = KINDS) -> Progress | None:
    """The last job of these kinds at any desk, running or finished."""
    kinds = tuple(kinds)
    jobs = filter(None, (desk.last_of(kinds) for desk in desks))
    return max(jobs, key=lambda job: job.number, default=None)


def result_at(desks: Iterable[Desk], kind: str, of: type[JobResult]) -> JobResult | None:
    """The result of the last job of this kind; None before its end."""
    job = last_at(desks, [kind])
    return job.result if job is not None and isinstance(job.result, of) else None


def lent(config: ProbeMachineConfig, desks: Iterable[Desk], own: Desk) -> list[Desk]:
    """The other desks whose axes belong to the machine, by file or by name: they have to be released for its jobs."""
    files = {axis.path.resolve() for axis in config.axes.values()}
    names = {axis.name for axis in config.axes.values()}
    return [
        desk for desk in desks if desk is not own and (desk.axis.path.resolve() in files or desk.axis.name in names)
    ]


# -- the store -------------------------------------------------------------------------------------------------------------
def store_at(config: ProbeMachineConfig, desk: Desk) -> RunOutStore | None:
    """The machine's store as far as it is open at a desk; None for a sealed one without its password."""
    if not config.store.sealed:
        return RunOutStore(config.store.directory, config.name)
    opened = desk.rights.other(probe.RUN_OUT)
    return opened if isinstance(opened, RunOutStore) else None


def open_store_at(
    desk: Desk, token: str | None, config: ProbeMachineConfig, reading_password: str, key_password: str = ""
) -> None:
    """Open the machine's sealed store at a desk, until control changes. key_password: of its builder's key, needed for changes.

    Raises NotInControlError, WrongPasswordError, and InputError for a missing or damaged file.
    """

    def opening() -> RunOutStore:
        store = probe.opened_store(config, lambda: reading_password, (lambda: key_password) if key_password else None)
        if store.path.exists():
            store.load()
        return store

    desk.open_other(token, probe.RUN_OUT, opening)


@dataclass(frozen=True)
class HistoryEntry:
    """One measurement of the history. verdict: stored, refused or broken off; why: in English, "" for one that is
    stored
    """

    when: datetime
    mode: str
    x_um: float
    y_um: float
    tip_radius_mm: float
    closure_um: float
    verdict: str
    why: str


@dataclass(frozen=True)
class ProbeRecord:
    """in_force: None for nothing, or a sealed store; since: date of its measurement; history: the oldest first;
    trouble: why it cannot be read
    """

    in_force: RunOut | None
    since: datetime | None
    history: Sequence[HistoryEntry]
    trouble: str = ""


def probe_record(config: ProbeMachineConfig, store: RunOutStore | None) -> ProbeRecord:
    """The values in force and the history; reads files. store: as far as it is open"""
    plain = store or RunOutStore(config.store.directory, config.name)
    history = history_entries(plain.history())
    if store is None or not store.path.exists():
        return ProbeRecord(None, None, history)
    try:
        known, when = store.load()
    except InputError as error:
        return ProbeRecord(None, None, history, str(error))
    return ProbeRecord(known, _date(when), history)


def history_entries(rows: Sequence[Mapping[str, str]]) -> list[HistoryEntry]:
    """The rows of `RunOutStore.history` as measurements, the latest `SHOWN`; a closure is that of the worst turn,
    µm.
    """
    found: list[HistoryEntry] = []
    for row in rows:
        when, closure_um = _date(row["time"]), _number(row["closure_um"])
        if when is None:
            continue
        if row["turn"] != "1" and found:
            worst_um = max(found[-1].closure_um, closure_um, key=abs)
            found[-1] = replace(found[-1], closure_um=worst_um)
            continue
        verdict, _, why = row["verdict"].partition(": ")
        why = (why.partition(": ")[2] or why) if verdict == BROKEN_OFF else why  # its error's kind, and what that said
        x_um, y_um, radius_mm = (_number(row[name]) for name in ("x_um", "y_um", "tip_radius_mm"))
        found.append(HistoryEntry(when, row["mode"], x_um, y_um, radius_mm, closure_um, verdict, why))
    return found[-SHOWN:]


def _date(text: str) -> datetime | None:
    try:
        return datetime.fromisoformat(text)
    except ValueError:
        return None


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


@dataclass(frozen=True)
class HistoryCurves:
    """begun: date of the first measurement; the others at minutes, hours or days (unit) after it. x, y: of those put
    into force, µm; left_out: of the others
    """

    begun: datetime
    unit: str
    x: Points
    y: Points
    left_out: Points


def history_curves(history: Sequence[HistoryEntry]) -> HistoryCurves | None:
    """Run-out over time, µm; None without any."""
    if not history:
        return None
    begun = history[0].when
    lasted_s = (history[-1].when - begun).total_seconds()
    unit, unit_s = next((one for one in UNITS.items() if lasted_s < MOST_OF_A_UNIT * one[1]), ("days", UNITS["days"]))
    curves = HistoryCurves(begun, unit, [], [], [])
    for one in history:
        later = (one.when - begun).total_seconds() / unit_s
        if one.verdict == STORED:
            curves.x.append((later, one.x_um))
            curves.y.append((later, one.y_um))
        else:
            curves.left_out.extend([(later, one.x_um), (later, one.y_um)])
    return curves


# -- one measurement -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Contact:
    """Feed of X until a contact. pulses: the feed in pulses of the machine file's size"""

    turn: int
    angle_deg: int
    feed_mm: float
    pulses: float


def contacts(config: ProbeMachineConfig, job: Progress | None) -> list[Contact]:
    """The contacts of an M90 measured so far."""
    if job is None:
        return []
    feeds = {figure.name: figure.value for figure in job.figures if isinstance(figure, Measured)}
    wanted = ((turn, angle) for turn in range(1, config.block.turns + 1) for angle in ANGLES_DEG)
    return [
        Contact(turn, angle, feed_mm, feed_mm / config.probe.pulse_mm)
        for turn, angle in wanted
        if (feed_mm := feeds.get(contact_name(turn, angle))) is not None
    ]


def worst_closure_um(measurement: RunOutMeasurement) -> float:
    """Closure of the turn that closes worst, µm."""
    return max((turn.closure_um for turn in measurement.turns), key=abs)


def std_um(config: ProbeMachineConfig, measurement: RunOutMeasurement) -> float | None:
    """Standard uncertainty of Δx and of Δy, µm; None of one turn."""
    return run_out_std_um(measurement.turns, config.position_step_mm(measurement.mode))


def angle_deg(found: RunOut) -> float:
    """Direction of the run-out with the spindle at 0: counter-clockwise from +X, 0 to 360."""
    return math.degrees(math.atan2(found.y_mm, found.x_mm)) % 360.0


@dataclass(frozen=True)
class BallPositions:
    """Positions about the spindle axis, seen along it: distance in µm, bearing in degrees counter-clockwise from +X.

    run_out: of the ball's centre with the spindle at 0; at: for each angle of the spindle, from its contacts
    """

    run_out: tuple[float, float]
    at: Mapping[int, tuple[float, float]]


def ball_positions(config: ProbeMachineConfig, measurement: RunOutMeasurement) -> BallPositions:
    """Position of the ball's centre at each angle.

    A contact at one angle gives the offset towards the face; the contact 90° before gives the offset across the face.
    The positions lie on one circle as far as the contacts close.
    """
    found, feeds = measurement.run_out, measurement.feeds
    return BallPositions((found.size_um, angle_deg(found)), _places(feeds, config.block.facing))


def _places(feeds: FourFeeds, facing: int) -> dict[int, tuple[float, float]]:
    n_mm = (feeds.n_0_mm, feeds.n_90_mm, feeds.n_180_mm, feeds.n_270_mm)
    mean_mm = sum(n_mm) / len(n_mm)
    off_um = [UM_PER_MM * facing * (mean_mm - n) for n in n_mm]  # along X
    places = {}
    for number, angle in enumerate(ANGLES_DEG):
        x_um, y_um = off_um[number], off_um[number - 1]
        places[angle] = (math.hypot(x_um, y_um), math.degrees(math.atan2(y_um, x_um)) % 360.0)
    return places
