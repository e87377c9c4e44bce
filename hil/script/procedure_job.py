"""The job of a user's procedure: its plan is held against the axis, its rows are journaled as they come."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from types import TracebackType
from typing import Any

from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.files import read_text
from hil.axis.axis_file import AxisConfig
from hil.correction.store import compensation_in_force
from hil.desk.axis_thread import DeskConnection
from hil.desk.job import Job, Workplace, tell_unchecked
from hil.desk.plan import OF_PROCEDURE, Move, Plan, PlannedWrite
from hil.desk.zero_statement import NO_STATEMENT, ZeroStatement
from hil.effects.user_code import in_short
from hil.machine.events import Event, Listener, Point, silent
from hil.records.journal import FINISHED, Campaign, RowJournal
from hil.records.rows import UM_PER_MM, Records, parse_csv
from hil.script.axis import Axis
from hil.script.given import Passwords
from hil.script.procedure import Procedure, Row, file_of, line_of, naming_the_line, shown_file, values_of


@dataclass(frozen=True)
class Carried:
    """A procedure that was carried out: the folder of its campaign and all its rows."""

    campaign: Path
    records: Records


def procedure_plan(procedure: Procedure, axis: AxisConfig) -> Plan:
    """Its moves and writes, and the way to the datum before them.

    Raises InputError, naming file and line, for a plan that fails or that leaves the limits of the axis file.
    """
    kind = type(procedure)
    with naming_the_line(kind, "plan"):
        moves = tuple(procedure.plan(Axis(axis, Passwords(None, None), silent)))
    for move in moves:
        wrong = _objection(move, axis)
        if wrong:
            raise InputError(f"plan() {wrong}", path=shown_file(kind), line=line_of(kind, "plan"))
    how = axis.measurement
    datum = Move("measure", how.reference_mm - how.overrun_mm, how.reference_mm, how.velocity_mm_s)
    return Plan(
        axis.name,
        axis.drive.backend,
        (datum, *(replace(move, what="measure") for move in moves)),
        (PlannedWrite("rows", str(axis.store.directory)),),
        how.home,
        how.reference_mm,
    )


def _objection(move: object, axis: AxisConfig) -> str:
    """Why a move cannot be made, "" for one that can."""
    if not isinstance(move, Move):
        return f'names {move!r:.60}, expected moves: hil.Move("measure", low_mm, high_mm, velocity_mm_s)'
    limits = axis.limits
    numbers = (move.low_mm, move.high_mm, move.velocity_mm_s)
    if not all(isinstance(one, int | float) and math.isfinite(one) for one in numbers) or move.low_mm > move.high_mm:
        return f"names {move}, expected numbers, low_mm ≤ high_mm"
    if move.low_mm < limits.travel_min_mm or move.high_mm > limits.travel_max_mm:
        travel = f"{limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm"
        return (
            f"moves between {move.low_mm:g} and {move.high_mm:g} mm, outside the travel of axis {axis.name}, {travel}"
        )
    if not 0.0 < move.velocity_mm_s <= limits.max_velocity_mm_s:
        return (
            f"moves at {move.velocity_mm_s:g} mm/s, expected more than 0 and at most {limits.max_velocity_mm_s:g} mm/s"
        )
    return ""


def procedure_job(
    axis: AxisConfig,
    procedure: Procedure,
    *,
    corrected: bool = False,
    resume: bool = False,
    zero: ZeroStatement = NO_STATEMENT,
) -> Job:
    """Job that returns a Carried. corrected: with what the axis's store holds in force.

    Raises InputError as `procedure_plan`, for a procedure that is over and cannot be resumed, and as `ZeroStatement.check`.
    """
    zero.check(resume=resume)
    kind = procedure.kind
    last = Campaign.latest(axis.store.directory, kind) if resume else None
    if last is not None and (last.directory / FINISHED).exists():
        raise InputError("is finished: there is nothing to resume", path=last.directory)

    def work(place: Workplace) -> Carried:
        session = place.machine().session
        compensation = place.opened_store().load() if corrected else None
        purpose: dict[str, Any] = {**axis.purpose(kind), "parameters": values_of(procedure)}
        purpose |= {} if compensation is None else compensation_in_force(compensation)
        campaign = Campaign.numbered(axis.store.directory, purpose, resume=resume)
        tell_unchecked(campaign, place.listener)
        with zero.applied(session):
            session.prepare(campaign.directory, compensation)
            session.compensation = compensation
            session.time_offset_s = max(session.time_offset_s, campaign.last_time_s() - session.elapsed_s())
            passed_ns = round((session.elapsed_s() + session.time_offset_s) * NS_PER_S)
            prepared = Axis(axis, Passwords(None, None), place.listener, DeskConnection(place.drive, session))
            rows = _Rows(procedure, campaign, place.listener)
            prepared.confine(plan.moves, rows.first_run, session.clock.now_ns() - passed_ns)
            records = rows.measured(prepared)
        campaign.finish()
        return Carried(campaign.directory, records)

    plan = zero.in_plan(procedure_plan(procedure, axis))
    return Job(kind, plan, work)


def resuming_job(axis: AxisConfig, procedure: type[Procedure], *, zero: ZeroStatement = NO_STATEMENT) -> Job:
    """Job that goes on with the last run of a procedure, with the parameters and the correction it was begun with.

    Raises as `procedure_job`, and InputError where no run was broken off.
    """
    begun = Campaign.unfinished(axis.store.directory, procedure.kind)
    if begun is None:
        raise InputError(f"holds no interrupted {procedure.kind}", path=axis.store.directory)
    given = begun.purpose["parameters"]
    with naming_the_line(procedure, "__init__"):
        made = procedure(**{name: tuple(one) if isinstance(one, list) else one for name, one in given.items()})
    return procedure_job(axis, made, corrected="tables" in begun.purpose, resume=True, zero=zero)


def _close(
    rows: Generator[Row],
    axis: Axis,
    kind: type[BaseException] | None,
    error: BaseException | None,
    _: TracebackType | None,
) -> None:
    """End the user's generator. After an error its `finally` moves nothing, and what it raises is noted beside that error."""
    if error is None:
        rows.close()
        return
    axis.hold()
    try:
        rows.close()
    except Exception as second:  # noqa: BLE001  (the code is the user's)
        error.add_note(f"and while run() was ended: {in_short(second)}")


class _Rows:
    """The rows of one procedure on their way into its campaign."""

    def __init__(self, procedure: Procedure, campaign: Campaign, listener: Listener) -> None:
        self._procedure, self._campaign, self._listener = procedure, campaign, listener
        self._kind = type(procedure)
        self._name = procedure.kind.removeprefix(OF_PROCEDURE)
        self._columns = campaign.columns(self._name)
        self._kept = self._on_disk()
        self.first_run = 1 if self._kept is None else int(self._kept.run[-1])

    def measured(self, axis: Axis) -> Records:
        """Run the procedure; all rows. Raises InputError, naming file and line, for code that fails and for a wrong row."""
        self._keep_source()
        kept, first = self._kept, self.first_run
        with ExitStack() as stack, naming_the_line(self._kind, "run"):
            rows = self._procedure.run(axis)
            if isinstance(rows, Generator):
                stack.push(partial(_close, rows, axis))
            wanted = self._checked(rows, first)
            begin = next(wanted, None)
            if begin is None:
                raise self._wrong(rows, f"run() yields no row of run {first} or a later one")
            names = tuple(begin) if self._columns is None else self._columns
            journal = stack.enter_context(self._campaign.rows(self._name, names))
            self._check(journal, begin, rows)  # before the rows that it takes the place of are withdrawn
            if kept is not None:
                journal.withdraw(int((kept.run == first).sum()), f"run {first} was broken off, and is measured again")
            for row in chain([begin], wanted):
                self._append(journal, row, rows)
            return parse_csv(read_text(journal.path), journal.path)

    def _keep_source(self) -> None:
        """A copy of the user's file beside the rows, as it is when they are measured."""
        path = Path(file_of(self._kind))
        if path.is_file():
            resumed = "" if self._kept is None else f"-from-run-{self.first_run}"
            self._campaign.write(f"{path.stem}{resumed}{path.suffix}", read_text(path).encode())

    def _on_disk(self) -> Records | None:
        if self._columns is None:
            return None
        with self._campaign.rows(self._name, self._columns) as journal:
            return journal.records()

    def _checked(self, rows: Iterable[Row], first: int) -> Iterator[Row]:
        """The rows from run `first` on."""
        last = -math.inf
        for row in rows:
            if not isinstance(row, Mapping) or "run" not in row:
                raise self._wrong(rows, f"run() yields {row!r:.60}, expected a row: axis.read().row(run)")
            if row["run"] < last:
                raise self._wrong(rows, f"run() yields a row of run {row['run']:g} after one of run {last:g}")
            last = row["run"]
            if last >= first:
                yield row

    def _check(self, journal: RowJournal, row: Row, rows: Iterable[Row]) -> None:
        """Raises InputError for a row of other columns than the first one's, and for one that is wrong."""
        lacking = [name for name in journal.names if name not in row]
        new = [name for name in row if name not in journal.names]
        if lacking or new:
            what = f"lacks {', '.join(lacking)}" if lacking else f"has the new column(s) {', '.join(new)}"
            raise self._wrong(rows, f"run() yields a row that {what}, expected the columns of the first")
        try:
            journal.check(row)
        except InputError as error:
            raise self._wrong(rows, f"run() yields a wrong row: {error.what}") from error

    def _append(self, journal: RowJournal, row: Row, rows: Iterable[Row]) -> None:
        self._check(journal, row, rows)
        journal.append(row)
        error_um = UM_PER_MM * (row["measured_mm"] - row["target_mm"])
        found = Point(f"run {row['run']:g}", row.get("time_s", float(len(journal))), error_um)
        self._listener(Event(self._name, f"run {row['run']:g}, row {len(journal)}", done=len(journal), found=found))

    def _wrong(self, rows: object, what: str) -> InputError:
        """An error at the line where the procedure stands."""
        frame = getattr(rows, "gi_frame", None)
        line = line_of(self._kind, "run") if frame is None else frame.f_lineno
        return InputError(what, path=shown_file(self._kind), line=line)
