"""A certificate: what was measured, stated with uncertainties against limits, and all that is needed to check it. No I/O.

One `Certificate` is made of records or of a verb's JSON result and is shown twice: on paper (`blocks`) and as a Digital Calibration
Certificate (`hil.report.dcc`). Both print the same numbers.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from types import MappingProxyType
from typing import Any

import numpy as np

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig, uncertainty_of
from hil.axis.certificate import CertificateConfig, Device, Party
from hil.axis.identity import identity
from hil.diagnosis.report.diagnosis import opening, percent
from hil.effects.catalogue import ALL
from hil.figures import FIGURES
from hil.figures.error_figures import rms
from hil.figures.iso230 import Iso230, symbol
from hil.figures.iso230_4 import MEANINGS as CIRCULAR
from hil.figures.uncertainty import CONFORMITY_RULE, Budget, Conformity, conformity
from hil.figures.verdict import At, targets_of
from hil.lost_motion.circle.figures import Trace
from hil.lost_motion.circle.report import CircleReport, polar_plot
from hil.records.rows import Floats, Records
from hil.ui.report import markup, plots
from hil.ui.report.blocks import (
    Block,
    Bullets,
    Drawing,
    Facts,
    Heading,
    Paragraph,
    ReportTable,
    TextSpan,
    Tile,
    Tiles,
    said,
)
from hil.ui.report.data import NamedCampaign, environment
from hil.ui.report.svg import Ground, Theme
from hil.ui.report.uncertainty import budget_of
from hil.ui.report.views import list_of, object_of, objects_of, value_of, with_unit

NOT_RECORDED = "not recorded with the measurement"
"""What a certificate says of an environment that its records do not hold."""

SIMULATED = "The machine is simulated: this states nothing of a real one."

UNITS: Mapping[str, str] = MappingProxyType(
    {
        "µm": r"\micro\metre",
        "mm": r"\milli\metre",
        "mm/s": r"\milli\metre\second\tothe{-1}",
        "mm/min": r"\milli\metre\minute\tothe{-1}",
        "s": r"\second",
        "°": r"\degree",
        "rad": r"\radian",
        "µrad": r"\micro\radian",
        "°C": r"\degreecelsius",
        "hPa": r"\hecto\pascal",
        "%": r"\percent",
        "ppm": r"\ppm",
        "ppm/K": r"\ppm\kelvin\tothe{-1}",
        "µm/°C": r"\micro\metre\degreecelsius\tothe{-1}",
        "kg": r"\kilogram",
        "ms": r"\milli\second",
        "µm/K": r"\micro\metre\kelvin\tothe{-1}",
        "µm/m": r"\micro\metre\metre\tothe{-1}",
        "µm/mm": r"\micro\metre\milli\metre\tothe{-1}",
        "µm/m²": r"\micro\metre\metre\tothe{-2}",
        "µm/kg": r"\micro\metre\kilogram\tothe{-1}",
        "µm/%": r"\micro\metre\percent\tothe{-1}",
        "µm·s²/mm²": r"\micro\metre\second\tothe{2}\milli\metre\tothe{-2}",
        "rows": r"\one",
        "1": r"\one",
    }
)
"""Every unit of a certificate -> its form in the D-SI (SmartCom, D-SI guide 2.2)."""


@dataclass(frozen=True)
class Stated:
    """One figure. value: None where the measurement cannot give it; expanded: U at k = 2, None where not known; limit: upper one."""

    symbol: str
    meaning: str
    value: float
    unit: str
    expanded: float | None = None
    limit: float | None = None

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise InputError(f"{self.symbol} is in {self.unit!r}, expected a unit of {', '.join(UNITS)}")

    @property
    def verdict(self) -> Conformity | None:
        """Against the limit, None without one."""
        return None if self.limit is None else conformity(abs(self.value), self.expanded, self.limit)


@dataclass(frozen=True)
class Series:
    """Values in rows, (n,) each: symbol -> (unit, values). The first is what the others are at."""

    name: str
    columns: Mapping[str, tuple[str, Floats]]


@dataclass(frozen=True)
class Certificate:
    """What a certificate states.

    sentence: the result in one; standard, clauses, method: how it was measured; stated: figures, the one that is decided first; files:
    name -> SHA-256 of the records; setup, surroundings: name -> text; conditions: name -> (unit, lowest, highest);
    simulated: whether the machine is; short_of: what the standard asks for beyond what was done, "" for nothing.
    """

    kind: str
    title: str
    sentence: str
    standard: str
    clauses: str
    method: str
    stated: tuple[Stated, ...]
    config: CertificateConfig
    axis: str
    setup: Mapping[str, str]
    surroundings: Mapping[str, str]
    conditions: Mapping[str, tuple[str, float, float]]
    files: Mapping[str, str]
    begun: date
    ended: date
    issued: str
    series: Series | None = None
    notes: tuple[str, ...] = ()
    sources: tuple[tuple[str, str, float], ...] = ()
    drawings: tuple[Drawing, ...] = field(default=(), compare=False)
    simulated: bool = False
    short_of: str = ""

    @property
    def number(self) -> str:
        """Number of the certificate: the same for the same records, axis and day."""
        told = "\n".join([self.kind, self.axis, *(f"{name} {digest}" for name, digest in sorted(self.files.items()))])
        return f"{self.config.number}-{self.ended:%Y%m%d}-{hashlib.sha256(told.encode()).hexdigest()[:10]}"

    @property
    def verdict(self) -> Conformity | None:
        """That of the first figure with a limit, None where none has one."""
        return next((one.verdict for one in self.stated if one.verdict is not None), None)


@dataclass(frozen=True)
class Common:
    """What every kind of certificate needs beside the measurement."""

    axis: AxisConfig
    files: Mapping[str, str]
    begun: date
    ended: date
    issued: str
    limit_um: float | None = None
    doubts: tuple[str, ...] = ()  # what could not be checked of the records
    simulated: bool = False

    @property
    def config(self) -> CertificateConfig:
        """Raises InputError for an axis file without [certificate]."""
        if self.axis.certificate is None:
            raise InputError("has no [certificate], which a certificate needs", path=self.axis.path)
        return self.axis.certificate

    @property
    def limit(self) -> float | None:
        """Largest A that is allowed, µm: the one given, else that of the axis file."""
        return self.limit_um if self.limit_um is not None else self.axis.correction.accuracy_limit_um

    def made(self, **parts: Any) -> Certificate:
        """The certificate with what all kinds have in common."""
        common = {
            "config": self.config,
            "axis": self.axis.name,
            "files": self.files,
            "begun": self.begun,
            "ended": self.ended,
        }
        setup = {name: text for name, text in identity(self.axis).items() if name != "Axis"}
        usual: dict[str, Any] = {"issued": self.issued, "setup": setup, "surroundings": {}, "conditions": {}}
        told: dict[str, Any] = {"notes": (*self.doubts, *parts.get("notes", ()))}
        if self.simulated:
            told["notes"] = (SIMULATED, *told["notes"])
            told["title"] = f"SIMULATED MACHINE: {parts['title']}"
            told["sentence"] = f"Of a simulated machine. {parts['sentence']}"
            told["simulated"] = True
        return Certificate(**(usual | common | parts | told))


def positioning(common: Common, campaign: NamedCampaign) -> Certificate:
    """Of positioning, ISO 230-2. Raises InputError for records without its figures, and for a corrected axis measured at
    its tables' own targets: what a table does there is not what it does between them.
    """
    figures = campaign.figures()
    if not isinstance(figures, Iso230):
        raise InputError(f"has no figures of ISO 230-2: {figures}", path=campaign.source or None)
    at = _at(common, campaign)
    if at not in (At.OTHER, At.UNCORRECTED):
        raise InputError(
            f"was measured corrected and {at.value}, where a table is at its best; a certificate states A at other targets:"
            " measure with `hil verify`",
            path=campaign.source or None,
        )
    known = budget_of(campaign, uncertainty_of(common.axis))
    why = known if isinstance(known, str) else "the axis file has no [uncertainty]" if known is None else ""
    stated = tuple(
        Stated(name, FIGURES[name], value, "µm", _expanded(known, name), common.limit if name == "A" else None)
        for name, value in figures.figures().items()
        if value is not None
    )
    how = f"with the correction in force, {at.value}" if at is At.OTHER else at.value
    accuracy = next((one for one in stated if one.symbol == "A"), None)
    first, last = float(figures.target_mm[0]), float(figures.target_mm[-1])
    between = f"from {first:g} to {last:g} mm"
    known_a = "not known" if accuracy is None else _told(accuracy)
    if accuracy is None and common.limit is not None:
        known_a += f"; undecided against a limit of {markup.number(common.limit)} µm"
    short_of = "; ".join(note for note in figures.notes if "the standard asks for" in note)
    known_a += f" ({short_of})" if short_of else ""
    sentence = f"The bi-directional accuracy of positioning of axis {common.axis.name} {between}, {how}, is {known_a}."
    columns = {"target": ("mm", figures.target_mm)}
    for name in ("mean_up", "mean_down", "s_up", "s_down", "B_i"):
        if (values := getattr(figures, name)) is not None:
            columns[name] = ("µm", values)

    def draw(theme: Theme, ground: Ground) -> Any:
        return plots.error_plot(campaign, theme, common.axis.correction.band, ground)

    caption = "Error (measured − target) against position: each run, mean ± 2s of each direction, and A."
    how_measured = common.axis.measurement
    return common.made(
        kind="positioning",
        title=f"Positioning of axis {common.axis.name}",
        sentence=sentence,
        short_of=short_of,
        standard="ISO 230-2:2014",
        clauses="clause 5 (test procedure), clause 3 (figures); uncertainty by ISO/TR 230-9:2005",
        method=(
            f"{figures.m} targets {between}, {figures.n} approaches in each direction,"
            f" {how_measured.velocity_mm_s:g} mm/s between targets,"
            f" {how_measured.dwell_s:g} s of dwell, {how_measured.reading_s:g} s averaged; measured {how}"
        ),
        stated=stated,
        series=Series("per target", columns),
        surroundings=environment(campaign.records),
        conditions=_conditions(campaign.records),
        notes=(*figures.notes, *((f"U is not known: {why}",) if why else ())),
        sources=tuple((one.name, one.how, one.expanded_um) for one in known.contributions)
        if isinstance(known, Budget)
        else (),
        drawings=(Drawing("error", "error", draw, "Error against position", caption),),
    )


def _at(common: Common, campaign: NamedCampaign) -> At:
    """Against the targets that the axis file states now, and those that the campaign was measured with."""
    own = (*common.axis.measurement.targets_mm, *campaign.calibrated_mm)
    return targets_of(campaign.records, own, corrected=campaign.corrected)


def loop(common: Common, before: NamedCampaign, after: NamedCampaign, diagnosis: Mapping[str, Any]) -> Certificate:
    """Of a closed loop: the effects that were found, and the error before and after at fresh targets.

    diagnosis: JSON form of `hil diagnose`. U of a parameter is twice its standard error; that of a root mean square is
    twice RMS/√(2n), its scatter over n rows that are normal and independent.
    """
    stated = [
        Stated("RMS after", "root mean square of the error after, fresh rows", *_rms(after.records)),
        Stated("RMS before", "root mean square of the error before, fresh rows", *_rms(before.records)),
    ]
    known = {effect.id for effect in ALL}
    for finding in objects_of(diagnosis.get("findings")):
        effect = str(finding.get("effect"))
        for name, form in object_of(finding.get("parameters")).items():
            value, std = value_of(form, "value"), value_of(form, "std")
            unit = with_unit(name)[1] or ("1" if effect in known else "")  # of a user's effect not known: left out
            if value is not None and unit:
                stated.append(
                    Stated(f"{effect} {name}", f"parameter of {effect}", value, unit, 2 * std if std else None)
                )
        if (sure := value_of(finding, "confidence")) is not None:
            stated.append(Stated(f"{effect} confidence", f"probability of {effect} among its rivals", sure, "1"))

    def draw(theme: Theme, ground: Ground) -> Any:
        return plots.before_after_plot((before, after), theme, None, ground)

    if np.array_equal(before.records.measured_mm, after.records.measured_mm):
        raise InputError(f"{before.label} and {after.label} hold the same rows: nothing was measured again")
    for one in (before, after):
        if (at := _at(common, one)) in (At.CALIBRATED, At.MIXED):
            raise InputError(
                f"{one.label} was measured corrected and {at.value}, and a loop is proven at other targets"
            )
    names = f"{before.label}; {after.label}"
    return common.made(
        kind="loop",
        title=f"Closed loop on axis {common.axis.name}",
        sentence=opening(diagnosis, before, after),
        standard="root mean square over fresh rows",
        clauses="no standard: the effects are those of the catalogue (`hil help diagnosis`)",
        method=f"{len(before.records)} rows before and {len(after.records)} after, measured anew at other targets",
        stated=tuple(stated),
        surroundings=environment(after.records),
        conditions=_conditions(after.records),
        notes=tuple(map(str, list_of(diagnosis.get("notes")))),
        drawings=(
            Drawing(
                "compare", "before-after", draw, "Before and after", f"Error against position on one scale: {names}."
            ),
        ),
    )


def _rms(records: Records) -> tuple[float, str, float]:
    rms_um = rms(records.error_um)
    return rms_um, "µm", 2.0 * rms_um / math.sqrt(2 * len(records))


def _expanded(known: Budget | str | None, name: str) -> float | None:
    return known.figures_um.get(name) or None if isinstance(known, Budget) else None


def _conditions(records: Records) -> dict[str, tuple[str, float, float]]:
    named = [name for name in records.columns if name.startswith(("air_", "temp_"))]
    found = {name: records[name][np.isfinite(records[name])] for name in named}
    units = {"_c": "°C", "_hpa": "hPa", "_percent": "%"}
    ends = {name: next((unit for end, unit in units.items() if name.endswith(end)), None) for name in named}
    return {
        name: (unit, float(found[name].min()), float(found[name].max()))
        for name, unit in ends.items()
        if unit is not None and len(found[name])
    }


def told(one: Stated) -> str:
    """A figure with its uncertainty, as text."""
    value, spread = _number_and_spread(one)
    text = value if one.expanded is None else f"{value} ± {spread}"
    return text if one.unit == "1" else f"{text} {one.unit}"


def _number_and_spread(one: Stated) -> tuple[str, str]:
    """Value and U as text: µm with two decimals, all else with four and two significant digits; a probability in percent."""
    if one.symbol.endswith(" confidence"):
        return percent(one.value), "–"
    if one.unit == "µm":
        return markup.number(one.value), markup.number(one.expanded)
    return markup.significant(one.value), markup.significant(one.expanded, 2)


def _told(one: Stated) -> str:
    spread = " (U, k = 2)" if one.expanded is not None else " (its uncertainty is not known)"
    if one.limit is None:
        return f"{one.symbol} = {told(one)}{spread}; no limit was agreed"
    return f"{one.symbol} = {told(one)}{spread} against a limit of {markup.number(one.limit)} µm: {one.verdict}"


def blocks(certificate: Certificate, signer: str) -> list[Block]:
    """The certificate on paper, without the title. signer: fingerprint of the builder's key."""
    decided = next((one for one in certificate.stated if one.limit is not None), certificate.stated[0])
    verdict = certificate.verdict
    good = {Conformity.PASS: True, Conformity.FAIL: False}.get(verdict) if verdict is not None else None
    tiles = [] if verdict is None else [Tile("Verdict", verdict.value, below=certificate.short_of, good=good)]
    tiles.append(
        Tile(
            decided.symbol,
            told(decided).removesuffix(f" {decided.unit}"),
            decided.unit,
            "U at k = 2" if decided.expanded is not None else "U is not known",
        )
    )
    if decided.limit is not None:
        tiles.append(Tile("Limit", markup.number(decided.limit), decided.unit))
    rows: list[tuple[str, ...]] = [
        (symbol(one.symbol), *_number_and_spread(one), "" if one.unit == "1" else one.unit, one.meaning)
        for one in certificate.stated
    ]
    head: tuple[str, ...] = ("Figure", "value", "U (k = 2)", "unit", "")
    rule: list[Block] = []
    if verdict is not None:
        decisions = [
            ("–", "–") if one.limit is None or one.verdict is None else (markup.number(one.limit), one.verdict.value)
            for one in certificate.stated
        ]
        rows = [(*row[:-1], *decision, row[-1]) for row, decision in zip(rows, decisions, strict=True)]
        head = (*head[:-1], "limit", "verdict", "")
        rule = [said(f"Decided by {CONFORMITY_RULE}.", "muted")]
    config = certificate.config
    parts: list[Block] = [
        Tiles(tuple(tiles)),
        Paragraph((TextSpan(certificate.sentence, "strong"),)),
        *rule,
        ReportTable(head, tuple(rows), "meaning"),
        *certificate.drawings,
        Heading("What was measured, with what"),
        Facts(
            {
                "Machine": _device(config.machine),
                "Axis": f"{certificate.axis}, {certificate.setup.get('Travel', '')}".rstrip(", "),
                "Drive": f"{_device(config.drive)}; {certificate.setup.get('Drive', '')}".rstrip("; "),
                "Instrument": f"{_device(config.instrument)}; {certificate.setup.get('Instrument', '')}".rstrip("; "),
                **{
                    name: text
                    for name, text in certificate.setup.items()
                    if name not in ("Travel", "Drive", "Instrument")
                },
                **(certificate.surroundings or ({} if certificate.conditions else {"Environment": NOT_RECORDED})),
            }
        ),
        Heading("How"),
        Facts({"Standard": f"{certificate.standard}, {certificate.clauses}", "Procedure": certificate.method}),
    ]
    if certificate.sources:
        lines = tuple((name, markup.number(value), how) for name, how, value in certificate.sources)
        parts.append(
            ReportTable(
                ("Contribution", "U, µm (k = 2)", ""),
                lines,
                "meaning",
                "Uncertainty of measurement: what U of the first figure is from; the squares add up",
            )
        )
    remarks = (*certificate.notes, *config.notes)
    return [
        *parts,
        *([Bullets(remarks, "remarks")] if remarks else []),
        Heading("Who and when"),
        Facts(
            {
                "Measured": f"{_days(certificate.begun, certificate.ended)}, {', '.join(certificate.files)}",
                "Place": _place(config),
                "Issued": certificate.issued,
                "Laboratory": _party(config.laboratory),
                "Customer": _party(config.customer),
                "Responsible": config.person,
                "Key": f"signed with the builder's key {signer}; check with `hil check FILE --builder builder.pub`",
            }
        ),
        ReportTable(("Records", "SHA-256"), tuple(certificate.files.items()), "hash"),
        ReportTable(("Place and date", f"Signature of {config.person}"), (("", ""),), "signature"),
    ]


def _place(config: CertificateConfig) -> str:
    """Where the machine stands."""
    party = {"customer": config.customer, "laboratory": config.laboratory}.get(config.place)
    return config.place if party is None else f"{config.place}: {_party(party)}"


def _device(one: Device) -> str:
    text = f"{one.maker} {one.model}, serial number {one.serial}".strip()
    if one.calibrated is not None:
        text += f"; calibrated {one.calibrated}"
    if one.due is not None:
        text += f", due {one.due}"
    return f"{text}; certificate {one.certificate}" if one.certificate else text


def _party(one: Party) -> str:
    return ", ".join(
        part for part in (one.name, one.street, f"{one.post_code} {one.city}".strip(), one.country, one.email) if part
    )


def _days(begun: date, ended: date) -> str:
    return str(begun) if begun == ended else f"{begun} to {ended}"


def of_result(common: Common, result: Mapping[str, Any]) -> Certificate:
    """Of the JSON result of `hil circle`, `hil iso230-4` or `hil probe measure`. Raises InputError for any other."""
    if (axes := list_of(result.get("axes"))) and common.axis.name not in axes:
        raise InputError(
            f"was driven with the axes {', '.join(map(str, axes))}, and the axis file is of {common.axis.name}"
        )
    if isinstance(result.get("circles"), Mapping) and result["circles"]:
        name, last = list(result["circles"].items())[-1]
        in_force = str(object_of(last).get("in_force", name))
        return _circle(common, object_of(last).get("iso230_4"), in_force, _polar(result, name))
    if isinstance(result.get("iso230_4"), Mapping):
        return _circle(common, result["iso230_4"], "")
    if isinstance(result.get("run_out"), Mapping):
        return _run_out(common, result)
    raise InputError("is no result of `hil circle`, `hil iso230-4` or `hil probe measure`")


_SENSES = {"cw": "clockwise", "ccw": "counter-clockwise"}


def _polar(result: Mapping[str, Any], name: str) -> tuple[Drawing, ...]:
    """The driven circle with its deviations magnified; none where the result has no samples."""
    one, sense = object_of(object_of(result.get("circles")).get(name)), value_of(result, "sense")
    samples = [np.asarray(list_of(one.get(key)), dtype=np.float64) for key in ("angle_deg", "deviation_um")]
    if sense is None or not len(samples[0]) or len(samples[0]) != len(samples[1]):
        return ()
    names = [str(axis) for axis in list_of(result.get("axes"))]
    first, second = names if len(names) == 2 else ("first axis", "second axis")
    shown = CircleReport("", {str(one.get("in_force", name)): Trace(*samples)}, (first, second), int(sense))

    def draw(theme: Theme, _: Ground) -> Any:
        return polar_plot(shown, theme)

    caption = "Radius driven less nominal radius, magnified; outside the bold circle is too far out."
    return (Drawing("polar", "polar", draw, "Deviation around the circle, magnified", caption),)


def _circle(common: Common, form: object, in_force: str, drawings: tuple[Drawing, ...] = ()) -> Certificate:
    """Of a circular test, ISO 230-4. The limit is that of G(b), or of G where one sense was driven."""
    figures = object_of(form)
    paths = objects_of(figures.get("paths"))
    radius = value_of(figures, "nominal_radius_mm")
    if not paths or radius is None:
        raise InputError("holds no figures of ISO 230-4")
    both = value_of(figures, "G_b_um")
    stated = []
    if both is not None:
        stated.append(Stated("G(b)", CIRCULAR["G_b"], both, "µm", None, common.limit_um))
        if (mean := value_of(figures, "D_um")) is not None:
            stated.append(Stated("D", CIRCULAR["D"], mean, "µm"))
    for path in paths:
        sense = str(path.get("direction"))
        limit = common.limit_um if both is None else None
        for key, symbol_, unit in (
            ("G_um", f"G {sense}", "µm"),
            ("F_max_um", f"F_max {sense}", "µm"),
            ("F_min_um", f"F_min {sense}", "µm"),
            ("start_deg", f"start angle {sense}", "°"),
            ("end_deg", f"end angle {sense}", "°"),
        ):
            if (value := value_of(path, key)) is None:
                raise InputError(f"a path of the result has no {key}")
            meaning = CIRCULAR.get(
                key.removesuffix("_um"), "angle of the first or last point, counter-clockwise from +"
            )
            stated.append(Stated(symbol_, meaning, value, unit, None, limit if key == "G_um" else None))
    stated.append(Stated("nominal radius", "radius of the nominal path", radius, "mm"))
    with_ = f", {in_force}" if in_force else ""
    return common.made(
        kind="circle",
        title=f"Circular test with axis {common.axis.name}",
        sentence=f"On a circle of {radius:g} mm{with_}, {_told(stated[0])}.",
        standard="ISO 230-4:2005",
        clauses="clause 3 (figures), evaluated about the least-squares circle",
        method="a full turn " + " and one ".join(_SENSES.get(str(path.get("direction")), "?") for path in paths),
        drawings=drawings,
        stated=tuple(stated),
        notes=("the uncertainty of the test is not known: nothing is decided against a limit",)
        if common.limit_um
        else (),
    )


def _run_out(common: Common, result: Mapping[str, Any]) -> Certificate:
    """Of a touch probe's run-out. No standard names it; the limit is that of its size."""
    form = object_of(result.get("run_out"))
    values = {name: value_of(form, name) for name in ("x_mm", "y_mm", "tip_radius_mm", "closure_um")}
    if any(value is None for value in values.values()):
        raise InputError(f"run_out lacks {next(name for name, value in values.items() if value is None)}")
    x, y, radius, closure = (float(value or 0.0) for value in values.values())
    stated = (
        Stated(
            "run-out",
            "distance of the ball from the spindle's axis",
            1000.0 * float(np.hypot(x, y)),
            "µm",
            None,
            common.limit_um,
        ),
        Stated("run-out x", "its part along x, spindle at 0°", x, "mm"),
        Stated("run-out y", "its part along y, spindle at 0°", y, "mm"),
        Stated("tip radius", "effective radius of the ball", radius, "mm"),
        Stated("closure", "(N0 + N180) − (N90 + N270)", closure, "µm"),
    )
    turns = len(list_of(result.get("turns")))
    return common.made(
        kind="probe",
        title=f"Touch probe of machine {result.get('machine')}",
        sentence=f"The touch probe of machine {result.get('machine')}: {_told(stated[0])}.",
        standard="JPH08348B2",
        clauses="run-out from contacts at four angles of the spindle; no standard of ISO names this figure",
        method=f"{turns} turn(s) of four contacts, by {result.get('mode')}",
        stated=stated,
        notes=("the uncertainty of the test is not known: nothing is decided against a limit",)
        if common.limit_um
        else (),
    )
