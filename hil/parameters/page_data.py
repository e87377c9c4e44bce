"""Contents of the screen's page on parameter sets: the outcome of the last job, row by row."""

from __future__ import annotations

from dataclasses import dataclass

from hil.app.desk.desk import Desk
from hil.app.desk.progress import Progress
from hil.parameters import job as parameters
from hil.parameters.compare import Comparison, Side
from hil.parameters.job import BackedUp
from hil.parameters.preflight import Objection
from hil.parameters.report import Ending, JobReport, Verdict, shown

KINDS = (
    parameters.BACKUP,
    parameters.COMPARE,
    parameters.VERIFY,
    parameters.DOWNLOAD,
    parameters.STORE,
    parameters.RESTORE,
    parameters.RESUME,
    parameters.ROLLBACK,
)
MOST_ROWS = 2000


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
class ParametersScreen:
    """Contents of the page.

    job: the latest of this page; outcome: by name, "" for none; same, differing: numbers of parameters that the drive holds as in the
    set and that it does not, None where unknown; warnings: in English.
    """

    job: Progress | None
    outcome: str = ""
    rows: tuple[ParameterRow, ...] = ()
    same: int | None = None
    differing: int | None = None
    backup: BackedUp | None = None
    warnings: tuple[str, ...] = ()


def parameters_screen(desk: Desk) -> ParametersScreen:
    """The contents at this moment."""
    jobs = [job for job in map(desk.last, KINDS) if job is not None]
    job = max(jobs, key=lambda one: one.number, default=None)
    if job is None:
        return ParametersScreen(None)
    if isinstance(job.result, Comparison):
        return _of_comparison(job, job.result)
    if isinstance(job.result, JobReport):
        return _of_report(job, job.result)
    return ParametersScreen(job, backup=job.result if isinstance(job.result, BackedUp) else None)


def _of_comparison(job: Progress, found: Comparison) -> ParametersScreen:
    rows = [
        ParameterRow(row.address, row.name, shown(row.held), shown(row.wanted), row.unit, row.side.name, row.why)
        for row in found.rows
        if row.side is not Side.SAME
    ]
    same = len(found.rows) - len(rows)
    objections = _objections(found.objections)
    outcome = "holds" if found.same else "unfit" if objections else "differs"
    warnings = tuple(str(one) for one in found.objections if not one.address)
    return ParametersScreen(
        job, outcome, (*objections, *rows)[:MOST_ROWS], same=same, differing=len(rows), warnings=warnings
    )


_ENDINGS = {
    Ending.UNCHANGED: "unchanged",
    Ending.WRITTEN: "written",
    Ending.PUT_BACK: "put_back",
    Ending.REFUSED: "refused",
    Ending.UNFINISHED: "unfinished",
}


def _of_report(job: Progress, report: JobReport) -> ParametersScreen:
    rows = [
        ParameterRow(row.address, row.name, shown(row.old), shown(row.new), row.unit, row.verdict.name)
        for row in report.rows
        if row.verdict is not Verdict.SAME
    ]
    same = len(report.rows) if report.ending.good else len(report.rows) - len(rows)
    outcome = "stored" if report.stored and report.good else _ENDINGS[report.ending]
    whole = [str(one) for one in report.objections if not one.address]
    warnings = tuple(line for line in (report.error, *whole, *report.notes) if line)
    return ParametersScreen(
        job,
        outcome,
        (*_objections(report.objections), *rows)[:MOST_ROWS],
        same=None if report.ending is Ending.UNFINISHED else same,
        differing=None if report.ending is Ending.UNFINISHED else len(report.rows) - same,
        warnings=warnings,
    )


def _objections(objections: list[Objection] | tuple[Objection, ...]) -> tuple[ParameterRow, ...]:
    """Objections to single parameters, as rows."""
    return tuple(ParameterRow(one.address, one.name, "", "", "", "", one.why) for one in objections if one.address)
