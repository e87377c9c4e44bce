"""The contents of the page of a diagnosis: the stored one of a measurement, as frozen values; a missing key is left
out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from hil.axis.axis_file import AxisConfig
from hil.calibration.explore import Exploration
from hil.diagnosis.loop.jobs.plan import unfinished_loop
from hil.diagnosis.loop.jobs.stored import StoredLoop, stored_loop
from hil.diagnosis.stored import can_be_held_out, read_stored, sources, stored_beside
from hil.machine.in_motion_settings import InMotion
from hil.ui.report.views import estimate_of, label_of, list_of, object_of, objects_of, value_of
from hil.ui.screen.campaigns import Measurement, measurements

Points = tuple[tuple[float, float], ...]
SIGNS = {1: "+", -1: "−"}


@dataclass(frozen=True)
class Curves:
    """A residual along a column, and the effect; points by direction, µm. label, over: in English

    smooth: the points of the effect are a curve along the column
    """

    label: str
    over: str
    residual: Mapping[int, Points]
    laid_over: Mapping[int, Points]
    smooth: bool


@dataclass(frozen=True)
class ShownFinding:
    """parameters: name, value, standard error; intervals: the ends of some, where ± does not say as much
    rivals: effect, weight, what separates it; texts in English

    form, inputs: of the effect, and the columns it reads, "" and () in files written before these were stored; rms_um:
    over the rows
    """

    effect: str
    confidence: float | None
    action: str
    explanation: str
    parameters: tuple[tuple[str, float | None, float | None], ...]
    rivals: tuple[tuple[str, float | None, str], ...]
    curves: Curves | None
    form: str = ""
    inputs: tuple[str, ...] = ()
    rms_um: float | None = None
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class ShownDiagnosis:
    """rms_um, peak_um: "before", "after" and "after_setup_fixed" -> the figure, on rows that were not fitted, none where the records
    cannot be held out (`can_be_held_out`); carriers:
    columns, their RMS in µm and its standard error; blind: effect, reason; next_run: the next measurement, "" for none

    current: of the rows that are there now
    """

    current: bool
    rows: int
    noise_um: tuple[float | None, float | None]
    rms_um: Mapping[str, float]
    peak_um: Mapping[str, float]
    recommended: bool
    unexplained: bool
    carriers: tuple[tuple[tuple[str, ...], float | None, float | None], ...]
    blind: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]
    next_run: str
    findings: tuple[ShownFinding, ...]
    position: Curves | None


@dataclass(frozen=True)
class DiagnosisScreen:
    """choices: measurements that can be diagnosed; shown: the stored diagnosis of the chosen one, None without;
    unfinished: exploration and passes of the interrupted loop; loop: the last one; None where there is none
    """

    choices: tuple[Measurement, ...]
    chosen: Measurement | None
    shown: ShownDiagnosis | None
    unfinished: tuple[Exploration, InMotion | None] | None
    loop: StoredLoop | None

    def choice(self, key: str) -> Measurement | None:
        return next((one for one in self.choices if one.key == key), None)


def diagnosis_screen(axis: AxisConfig, key: str = "") -> DiagnosisScreen:
    """key: of the chosen measurement, "" for the newest that has a diagnosis, or else the newest. Reads files. Raises
    InputError for a damaged diagnosis.
    """
    folder = axis.store.directory
    choices = tuple(measurements(folder))
    by_itself = next((one for one in choices if stored_beside(one.paths).exists()), choices[0] if choices else None)
    chosen = next((one for one in choices if one.key == key), by_itself)
    shown = None if chosen is None or not stored_beside(chosen.paths).exists() else read_shown(chosen)
    return DiagnosisScreen(choices, chosen, shown, unfinished_loop(folder), stored_loop(folder))


def read_shown(of: Measurement) -> ShownDiagnosis:
    """The stored diagnosis of a measurement. Raises InputError for a file that holds none."""
    form = read_stored(stored_beside(of.paths))
    drawn = object_of(form.get("drawn"))
    along = drawn.get("findings")
    curves = [_curves(one) for one in (along if isinstance(along, list) else [])]
    findings = objects_of(form.get("findings"))
    curves += [None] * (len(findings) - len(curves))
    forms = [*objects_of(drawn.get("forms")), *({} for _ in findings)]
    held_out = can_be_held_out(object_of(form.get("held_out")).get("how", "not stated"))
    stages = {name: object_of(form.get(name)) for name in ("before", "after", "after_setup_fixed") if held_out}
    return ShownDiagnosis(
        current=form.get("sources", sources(of.paths)) == sources(of.paths),
        rows=int(value_of(object_of(form.get("held_out")), "rows") or 0),
        noise_um=(value_of(form, "noise_floor_um"), value_of(form, "noise_floor_std_um")),
        rms_um=_figures(stages, "rms_um"),
        peak_um=_figures(stages, "peak_um"),
        recommended=form.get("recommended") is True,
        unexplained=form.get("unexplained") is True,
        carriers=tuple(map(_carrier, objects_of(form.get("carried_by")))),
        blind=tuple((str(one.get("effect")), str(one.get("reason"))) for one in objects_of(form.get("blind_to"))),
        notes=tuple(map(str, list_of(form.get("notes")))),
        next_run=str(object_of(form.get("next_measurement")).get("what", "")),
        findings=tuple(map(_finding, findings, curves, forms)),
        position=_curves(drawn.get("position")),
    )


def _figures(stages: Mapping[str, Mapping[str, Any]], name: str) -> dict[str, float]:
    return {stage: value for stage, figures in stages.items() if (value := value_of(figures, name)) is not None}


def _carrier(form: Mapping[str, Any]) -> tuple[tuple[str, ...], float | None, float | None]:
    columns = tuple(label_of(str(name)).partition(",")[0] for name in list_of(form.get("columns")))
    return columns, value_of(form, "rms_um"), value_of(form, "rms_std_um")


def _finding(form: Mapping[str, Any], curves: Curves | None, of: Mapping[str, Any]) -> ShownFinding:
    parameters = object_of(form.get("parameters")).items()
    rivals = objects_of(form.get("rivals"))
    return ShownFinding(
        str(form.get("effect")),
        value_of(form, "confidence"),
        str(form.get("action")),
        str(form.get("explanation", "")),
        tuple((name, value_of(one, "value"), value_of(one, "std")) for name, one in parameters),
        tuple((str(one.get("effect")), value_of(one, "confidence"), str(one.get("separate_by"))) for one in rivals),
        curves,
        str(of.get("name", "")),
        tuple(map(str, list_of(of.get("inputs")))),
        value_of(form, "rms_um"),
        {name: one.interval for name, form in parameters if (one := estimate_of(form)) and not one.is_symmetric},
    )


def _curves(form: object) -> Curves | None:
    if not isinstance(form, Mapping):
        return None
    residual, laid_over = (
        {sign: points for sign, name in SIGNS.items() if (points := _points(object_of(form.get(key)).get(name)))}
        for key in ("residual", "laid_over")
    )
    return Curves(str(form.get("label")), str(form.get("over")), residual, laid_over, form.get("smooth") is True)


def _points(values: object) -> Points:
    pairs = [one for one in list_of(values) if isinstance(one, list) and len(one) == 2]
    known = [(value_of(x, "value"), value_of(y, "value")) for x, y in pairs]
    return tuple((x, y) for x, y in known if x is not None and y is not None)
