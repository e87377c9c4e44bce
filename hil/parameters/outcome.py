"""The outcome of a parameter job as a screen shows it, row by row; kept in the axis's folder, to be read after a restart too."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import msgspec

from drivers.errors import InputError
from drivers.files import read_bytes, replace_file
from hil.axis.axis_file import DriveAxis
from hil.parameters.compare import Comparison, Side
from hil.parameters.preflight import Objection
from hil.parameters.report import Ending, JobReport, ParameterVerdict, shown

MOST_ROWS = 2000
_KEPT = "parameters/outcome.json"


@dataclass(frozen=True)
class BackedUp:
    """A backup's file, its number of parameters, and the number of parameters that could not be read."""

    path: Path
    parameters: int
    unreadable: int


@dataclass(frozen=True)
class ParameterRow:
    """One parameter that differs from the set. held: before the job; outcome: by name; why: reason in English where it has one."""

    address: str
    name: str
    held: str
    wanted: str
    unit: str
    outcome: str
    why: str = ""


@dataclass(frozen=True)
class Outcome:
    """outcome: by name, "" for none; same, differing: numbers of parameters that the drive holds as in the set and that it does not,
    None where unknown; warnings: in English; at: when a job of a server before this one ended, None for one of this server.
    """

    outcome: str = ""
    rows: tuple[ParameterRow, ...] = ()
    same: int | None = None
    differing: int | None = None
    backup: BackedUp | None = None
    warnings: tuple[str, ...] = ()
    at: datetime | None = None


def outcome_of(result: object) -> Outcome:
    """Of what a parameter job returned; empty for anything else."""
    if isinstance(result, Comparison):
        return _of_comparison(result)
    if isinstance(result, JobReport):
        return _of_report(result)
    return Outcome("backed_up", backup=result) if isinstance(result, BackedUp) else Outcome()


def keep_outcome(axis: DriveAxis, result: object) -> None:
    """Keep the outcome of a job that has just ended. Raises InputError, and OSError for a folder that cannot be made."""
    path = axis.store.directory / _KEPT
    path.parent.mkdir(parents=True, exist_ok=True)
    form = {**msgspec.to_builtins(outcome_of(result), enc_hook=str), "at": datetime.now().astimezone()}
    replace_file(path, msgspec.json.encode(form))


def kept_outcome(axis: DriveAxis) -> Outcome | None:
    """The outcome of the last job, also of an earlier run of the server; None without a readable one."""
    try:
        return msgspec.json.decode(read_bytes(axis.store.directory / _KEPT), type=Outcome, dec_hook=_decode)
    except (InputError, msgspec.MsgspecError):
        return None


def _decode(wanted: type, value: object) -> object:
    return Path(str(value)) if issubclass(wanted, Path) else value


def _of_comparison(found: Comparison) -> Outcome:
    rows = [
        ParameterRow(row.address, row.name, shown(row.held), shown(row.wanted), row.unit, row.side.name, row.why)
        for row in found.rows
        if row.side is not Side.SAME
    ]
    same = len(found.rows) - len(rows)
    objections = _objections(found.objections)
    outcome = "holds" if found.same else "unfit" if objections else "differs"
    warnings = tuple(str(one) for one in found.objections if not one.address)
    return Outcome(outcome, (*objections, *rows)[:MOST_ROWS], same=same, differing=len(rows), warnings=warnings)


def _of_report(report: JobReport) -> Outcome:
    rows = [
        ParameterRow(row.address, row.name, shown(row.old), shown(row.new), row.unit, row.verdict.name)
        for row in report.rows
        if row.verdict is not ParameterVerdict.SAME
    ]
    same = len(report.rows) if report.ending.good else len(report.rows) - len(rows)
    outcome = "stored" if report.stored and report.good else report.ending.name.lower()
    whole = [str(one) for one in report.objections if not one.address]
    warnings = tuple(line for line in (report.error, *whole, *report.notes) if line)
    return Outcome(
        outcome,
        (*_objections(report.objections), *rows)[:MOST_ROWS],
        same=None if report.ending is Ending.UNFINISHED else same,
        differing=None if report.ending is Ending.UNFINISHED else len(report.rows) - same,
        warnings=warnings,
    )


def _objections(objections: list[Objection] | tuple[Objection, ...]) -> tuple[ParameterRow, ...]:
    return tuple(ParameterRow(one.address, one.name, "", "", "", "", one.why) for one in objections if one.address)
