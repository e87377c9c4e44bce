"""Results of the jobs of a script: figures as attributes, rows, report, certificate, and a plot in a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.errors import CapabilityError, InputError
from hil.axis.axis_file import AxisConfig, accuracy_of, load_axis
from hil.desk.result import Result
from hil.figures.verdict import Accuracy
from hil.records.rows import Records
from hil.script.given import Passwords
from hil.ui.report.measured_result import ErrorFigures, MeasuredResult

if TYPE_CHECKING:  # what measures and fits loads slowly
    from drivers.parameters import ParameterValue
    from hil.calibration.calibrate import Calibration
    from hil.calibration.job import Verification
    from hil.correction.tables import TableSet
    from hil.diagnosis.loop.procedure import Loop
    from hil.doctor.procedure import Check
    from hil.parameters.compare import Comparison
    from hil.parameters.report import JobReport


@dataclass(frozen=True, repr=False)
class DoctorResult(Result):
    """What `doctor` found. checks: in the order in which they were made."""

    checks: tuple[Check, ...]

    @property
    def good(self) -> bool:
        """Whether every check is good."""
        return all(check.good for check in self.checks)

    @property
    def sentence(self) -> str:
        """How many checks are good, and which are not."""
        bad = [check.name for check in self.checks if not check.good]
        return f"doctor of {self.axis.name}: {len(self.checks)} checks, " + (
            f"not good: {', '.join(bad)}" if bad else "all good"
        )

    def form(self) -> Mapping[str, Any]:
        """As `hil doctor --json`."""
        return {"axis": self.axis.name, "good": self.good, "checks": [vars(check) for check in self.checks]}


@dataclass(frozen=True, repr=False)
class CalibrationResult(MeasuredResult):
    """A calibration."""

    axis: AxisConfig
    raw: Calibration

    @cached_property
    def before(self) -> ErrorFigures:
        """Errors of the uncorrected axis."""
        return ErrorFigures.of(self.raw.before)

    @cached_property
    def after(self) -> ErrorFigures:
        """Errors at the calibrated targets with the tables in force."""
        return ErrorFigures.of(self.raw.rounds[-1].records)

    @property
    def tables(self) -> TableSet:
        """The tables, stored and in force."""
        return self.raw.tables

    @property
    def good(self) -> bool:
        """Whether every section is inside the band; true without a band."""
        return self.raw.inside

    @property
    def records(self) -> Records:
        """Of the last round."""
        return self.raw.rounds[-1].records

    @property
    def sentence(self) -> str:
        """Before and after."""
        return f"calibration of {self.axis.name}: {self.before.in_short} before, {self.after.in_short} with the tables"

    def form(self) -> Mapping[str, Any]:
        """As `hil calibrate --json`, without the verification."""
        from hil.calibration.job import summarise  # noqa: PLC0415  (loads slowly)

        return summarise(self.axis, self.raw)

    def _page(self) -> str:
        from hil.calibration.report import calibration_report  # noqa: PLC0415  (plots are slow to import)

        return calibration_report(self.axis, self.raw)


@dataclass(frozen=True, repr=False)
class VerificationResult(MeasuredResult):
    """A verification."""

    axis: AxisConfig
    raw: Verification
    _passwords: Passwords

    @property
    def tables(self) -> TableSet | None:
        """The tables in force, None for the uncorrected axis."""
        return None if self.raw.compensation is None else self.raw.compensation.tables

    @cached_property
    def accuracy(self) -> Accuracy:
        """The accuracy A with its uncertainty U (k = 2) against the limit, by ISO 14253-1."""
        return accuracy_of(self.axis, self.raw.records, corrected=self.tables is not None)

    @cached_property
    def figures(self) -> ErrorFigures:
        """Figures of the errors at these targets."""
        return ErrorFigures.of(self.raw.records)

    @property
    def A_um(self) -> float | None:  # noqa: N802  (the standard's name)
        """The accuracy A of ISO 230-2, None if the rows cannot give it."""
        return self.accuracy.A_um

    @property
    def U_um(self) -> float | None:  # noqa: N802
        """Its expanded uncertainty, None without `[uncertainty]` in the axis file."""
        return self.accuracy.U_um

    @property
    def good(self) -> bool:
        """Whether A passes its limit and every section is inside the band, if these are given."""
        return self.raw.good and self.accuracy.good

    @property
    def records(self) -> Records:
        """Of the verification."""
        return self.raw.records

    @property
    def sentence(self) -> str:
        """The accuracy and its verdict."""
        return f"verification of {self.axis.name}: {self.accuracy}"

    def form(self) -> Mapping[str, Any]:
        """The figures of `hil verify --json`."""
        outside = [vars(section) for section in self.raw.outside]
        told = {"axis": self.axis.name, "good": self.good, "accuracy": self.accuracy.as_json()}
        return {**told, **vars(self.figures), "outside": outside}

    def _page(self) -> str:
        if self.tables is None:
            raise CapabilityError("the report of a verification is of tables in force, and there were none")
        from hil.calibration.report import verification_report  # noqa: PLC0415  (plots are slow to import)

        return verification_report(self.axis, self.tables, self.raw)

    def certificate(self, path: str | Path) -> Path:
        """Of the rows of this verification."""
        if self.campaign is None:
            return super().certificate(path)
        from hil.desk.worker_process import Passes  # noqa: PLC0415
        from hil.report.issue_certificate import CertificateOrder, builder_key, made_certificate, write_signed  # noqa: PLC0415
        from hil.report.job import named_campaign  # noqa: PLC0415  (plots are slow to import)

        if Path(path).suffix.lower() != ".pdf":
            raise InputError("is no name of a certificate, expected one ending in .pdf", path=path)
        rows = self.campaign / f"{'uncorrected' if self.tables is None else 'verify'}.csv"
        axis, campaign = load_axis(self.axis.path), named_campaign(Passes(rows.stem, (rows,)))
        made = made_certificate(CertificateOrder(axis, [str(rows)], [campaign]))
        write_signed(made, builder_key(axis, given=self._passwords.key), str(path))
        return Path(path)


@dataclass(frozen=True, repr=False)
class LoopResult(MeasuredResult):
    """A closed loop. stages: figures of its stages, in the order of time; explained: whether every cause was found."""

    axis: AxisConfig
    raw: Loop
    stages: Mapping[str, Mapping[str, Any]]
    explained: bool

    @property
    def effects(self) -> tuple[str, ...]:
        """Ids of the effects that were found."""
        return tuple(one.effect for one in self.raw.turn.diagnosis.findings)

    @cached_property
    def before(self) -> ErrorFigures:
        """Errors at other targets with the tables alone."""
        return ErrorFigures.of(self.raw.turn.before)

    @cached_property
    def after(self) -> ErrorFigures:
        """Errors at other targets with what was found."""
        return ErrorFigures.of(self.raw.turn.after)

    @property
    def good(self) -> bool:
        """Whether everything is explained and the axis measured no worse than before."""
        return self.explained

    @property
    def records(self) -> Records:
        """Of the exploration with what was found."""
        return self.raw.turn.after

    @property
    def sentence(self) -> str:
        """The peak before and after, and the effects."""
        found = ", ".join(self.effects) or "nothing"
        peaks = f"peak {self.before.peak_um:.2f} → {self.after.peak_um:.2f} µm"
        return f"loop of {self.axis.name}: {peaks}, found {found}"

    def form(self) -> Mapping[str, Any]:
        """The stages and the diagnosis, as `hil close-loop --json`."""
        diagnosis = self.raw.turn.follow.to_json()
        return {"axis": self.axis.name, "good": self.good, "stages": self.stages, "diagnosis": diagnosis}

    def _page(self) -> str:
        from hil.diagnosis.loop.report import loop_report  # noqa: PLC0415  (plots are slow to import)

        return loop_report(self.axis, self.raw)


@dataclass(frozen=True, repr=False)
class ProcedureResult(MeasuredResult):
    """Your own procedure, carried out. name: of its class; parameters: its values."""

    axis: AxisConfig
    name: str
    parameters: Mapping[str, Any]
    raw: Records

    @cached_property
    def figures(self) -> ErrorFigures:
        """Of the errors of its rows."""
        return ErrorFigures.of(self.raw)

    @property
    def good(self) -> bool:
        """Whether it came to its end."""
        return True

    @property
    def records(self) -> Records:
        """All rows."""
        return self.raw

    @property
    def path(self) -> Path:
        """The file of the rows. Raises InputError for a result without one."""
        if self.campaign is None:
            raise InputError("this result has no folder of rows")
        return next(self.campaign.glob("*.csv"))

    @property
    def sentence(self) -> str:
        """How many rows in how many runs, and their error."""
        runs = len(self.raw.runs)
        return f"{self.name} of {self.axis.name}: {len(self.raw)} rows in {runs} run(s), {self.figures.in_short}"

    def form(self) -> Mapping[str, Any]:
        """As `hil run --json`."""
        told = {"axis": self.axis.name, "procedure": self.name, "parameters": self.parameters}
        return {**told, "good": self.good, "records": str(self.path), "runs": self.raw.runs, **vars(self.figures)}

    def _page(self) -> str:
        from hil.axis.axis_file import uncertainty_of  # noqa: PLC0415
        from hil.axis.identity import identity  # noqa: PLC0415  (plots are slow to import)
        from hil.records.journal import name_of  # noqa: PLC0415
        from hil.ui.report.data import NamedCampaign, ReportData  # noqa: PLC0415
        from hil.ui.report.document import render_html  # noqa: PLC0415

        given = {name: str(value) for name, value in self.parameters.items()}
        rows = NamedCampaign(self.name, self.raw, source=name_of(self.path))
        title, known = f"{self.name} on axis {self.axis.name}", uncertainty_of(self.axis)
        return render_html(ReportData(title, (rows,), identity(self.axis) | given, uncertainty=known))


@dataclass(frozen=True, repr=False)
class ParameterComparison(Result):
    """A drive compared with a set."""

    raw: Comparison
    _given: Mapping[str, str]  # address -> as the script gave it

    @property
    def good(self) -> bool:
        """Whether the drive holds the set."""
        return self.raw.same

    @property
    def differing(self) -> dict[str, tuple[ParameterValue | None, ParameterValue | None]]:
        """By address, as it was given: the value in the drive and the value in the set; None where it could not be read."""
        return {
            self._given.get(row.address, row.address): (row.held, row.wanted)
            for row in self.raw.rows
            if row.side.name != "SAME"
        }

    @property
    def objections(self) -> tuple[str, ...]:
        """Why the set is not one for this drive: unknown addresses, values that do not fit, another model. Empty for none."""
        return tuple(map(str, self.raw.objections))

    @property
    def sentence(self) -> str:
        """Whether it does, else why not: of the parameters that differ the first three."""
        differ = [
            f"{name} is {'unknown' if held is None else repr(held)}, expected {wanted!r}"
            for name, (held, wanted) in self.differing.items()
        ]
        more = f" and {len(differ) - 3} more" if len(differ) > 3 else ""
        why = self.raw.error or "; ".join(self.objections) or ", ".join(differ[:3]) + more
        return f"parameters of {self.axis.name}: {'as the set' if self.good else why}"

    def form(self) -> Mapping[str, Any]:
        """What differs."""
        told = {"axis": self.axis.name, "same": self.good, "differing": self.differing}
        return {**told, "objections": self.objections}


@dataclass(frozen=True, repr=False)
class ParameterWriting(Result):
    """A set that was written, stored or put back, all or nothing."""

    raw: JobReport

    @property
    def good(self) -> bool:
        """Whether the drive holds what was asked for."""
        return self.raw.good

    @property
    def audited(self) -> bool | None:
        """Whether the drive held what it stored after a restart; None where no audit was asked for."""
        return self.raw.audited

    @property
    def objections(self) -> tuple[str, ...]:
        """Why nothing was written: unknown addresses, values that do not fit, another model. Empty for none."""
        return tuple(map(str, self.raw.objections))

    @property
    def sentence(self) -> str:
        """How it ended, what is known of the drive's memory, and why it failed."""
        why = "; ".join(filter(None, (self.raw.kept, self.raw.error, *self.objections)))
        return f"parameters of {self.axis.name}: {self.raw.ending.value}{f': {why}' if why else ''}"

    def form(self) -> Mapping[str, Any]:
        """How it ended."""
        told = {"axis": self.axis.name, "good": self.good, "ending": self.raw.ending.name}
        return {**told, "audited": self.audited, "objections": self.objections}
