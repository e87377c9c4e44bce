"""Thermal expansion of screw or scale: an error proportional to position and temperature rise, x·α·ΔT, or x·(1 -
e^(-t/τ)) while it warms.

The coefficient is in ppm/K. The growth is about the zero of the axis or, in forms of their own, about the point at which
screw or scale is held (a bearing at the far end, a home in mid-travel), which is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from hil.effects.base import (
    FARTHEST_POINT,
    POINT_KNOWN_TO,
    UM_PER_MM_PPM,
    Action,
    Columns,
    Effect,
    Estimate,
    Floats,
    Form,
    Rival,
    Term,
)
from hil.effects.survey import Survey
from hil.effects.warming import (
    ABOUT_A_POINT,
    REFERENCE_C,
    UNLIKE_ALONG,
    is_about_a_point,
    is_since_start,
    is_unlike_along,
    lag_of,
    rise,
    seen_in_rows,
    temperature_forms,
    time_unit,
)

STEEL_TO_ALUMINIUM_PPM_K = (2.0, 35.0)
"""Low-expansion alloys to above aluminium (about 23); a steel screw is 11 to 12."""
OF_WHAT_GROWS = ("temp_screw_c", "temp_scale_c")
"""Temperatures of what the position is taken from, by the name of their place: the growth follows one of them sooner than another."""


class ThermalExpansion(Effect):
    """error_um = α·(x - x₀)·(T - 20 °C)·10⁻³, α in ppm/K, x in mm, reference temperature of ISO 1; or by time since the
    start, in ppm. x₀ is zero, or free: then the basis is x·rise and rise, so that both are linear. As a refinement α changes
    along the travel: beside them (x - c)²/2h·rise, c the middle and h half the travel.
    """

    id: ClassVar[str] = "thermal_expansion"
    title: ClassVar[str] = "thermal expansion of screw or scale"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("air_index", "vary the air and the screw temperature apart: warm the screw by fast strokes in still air"),
        Rival("cosine", "measure once cold and once warm: a misaligned beam does not follow temperature"),
        Rival("thermal_drift", "compare both ends of the travel in one warm run: a drift is the same at both"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.has("target_mm"):
            return ()  # at one place it is a drift
        forms = temperature_forms(self.id, survey, extra_inputs=("target_mm",), likely=OF_WHAT_GROWS)
        travel = {"centre_mm": survey.centre_mm, "half_span_mm": survey.half_span_mm}
        free = [replace(f, constants={**f.constants, **travel}) for f in forms]
        about = (replace(f, name=f.name + ABOUT_A_POINT) for f in free)
        unlike = (
            replace(f, name=f.name + UNLIKE_ALONG + ABOUT_A_POINT, scan=False) for f in free if not is_since_start(f)
        )
        return (*forms, *about, *unlike)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        x = columns["target_mm"] * UM_PER_MM_PPM
        risen = rise(form, theta, columns)
        grown = x[:, None] * risen
        if is_unlike_along(form):
            away = columns["target_mm"] - form.constants["centre_mm"]
            bent = away**2 / (2.0 * form.constants["half_span_mm"]) * UM_PER_MM_PPM
            return np.hstack([grown, risen, bent[:, None] * risen])
        return np.hstack([grown, risen]) if is_about_a_point(form) else np.asarray(grown)

    def is_straight(self, form: Form) -> bool:
        return not is_unlike_along(form)

    def lag(self, form: Form, theta: Sequence[float]) -> tuple[str, float] | None:
        return lag_of(form, theta)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        if is_since_start(term.form) and not (seen := seen_in_rows(term)).determined:
            found = {"expansion_over_the_rows_ppm": seen.change, **seen.bounds(time_unit(term))}
        elif is_since_start(term.form):
            found = {"expansion_ppm": term.coefficient(0), f"time_constant_{time_unit(term)}": term.nonlinear(0)}
        else:
            found = {"coefficient_ppm_per_k": term.coefficient(0)}
            if is_unlike_along(term.form):
                found["change_to_the_end_ppm_per_k"] = term.coefficient(2)
            if term.theta:
                found |= term.positive(0, f"lag_{time_unit(term)}")
        point = fixed_point_mm(term)
        return found if point is None else found | {"fixed_point_mm": point}

    def explain(self, term: Term) -> str:
        first = term.coefficient(0)
        point = fixed_point_mm(term)
        about = f" about a fixed point at {point} mm" if point is not None else ""
        if is_about_a_point(term.form) and point is None:
            about = " about a point that these records do not determine"
        if is_since_start(term.form) and not (seen := seen_in_rows(term)).determined:
            return (
                f"The axis grows with time since the start{about}, by {seen.change} ppm of the position from the first row to the"
                f" last; {seen.open_end(time_unit(term))}."
            )
        if is_since_start(term.form):
            tau = term.nonlinear(0)
            return (
                f"The axis grows with time since the start{about}, by {first} ppm of the position in the end,"
                f" with a time constant of {tau} {time_unit(term)}: it warms up."
            )
        lag = f" seen through a lag of {term.positive_text(0, time_unit(term))}" if term.theta else ""
        unlike = ""
        if is_unlike_along(term.form):
            unlike = f" in mid-travel, by {term.coefficient(2)} ppm/K more at its upper end"
        return (
            f"The error grows with position{about} and {term.form.inputs[0]}{lag}: {first} ppm/K{unlike} (steel 11 to 12),"
            f" reference {REFERENCE_C:g} °C."
        )

    def implausible(self, term: Term) -> str | None:
        if is_about_a_point(term.form) and term.coefficients[0]:
            point = _zero_mm(term)
            travel = term.form.constants
            if point is not None and abs(point - travel["centre_mm"]) > FARTHEST_POINT * travel["half_span_mm"]:
                return f"a fixed point at {point:.4g} mm lies more than a travel outside the travel"
        if is_since_start(term.form):
            return None
        low, high = STEEL_TO_ALUMINIUM_PPM_K
        change = abs(term.coefficients[2]) if is_unlike_along(term.form) else 0.0
        growth = term.coefficients[0]
        if growth < 0.0:
            return f"{growth:.3g} ppm/K: neither screw nor scale moves the axis back as it warms"
        if low <= growth - change and growth + change <= high:
            return None
        said = f"{growth - change:.3g} to {growth + change:.3g}" if change else f"{growth:.3g}"
        return f"{said} ppm/K lies outside the {low:g} to {high:g} ppm/K of machine materials"


def _offset_index(term: Term) -> int:
    """Index of the coefficient of the rise itself."""
    return len(term.coefficients) // 2


def _bend(term: Term) -> tuple[float, float]:
    """Of a growth that changes along the travel: half the change of its slope, ppm/K per mm, and the middle, mm; else 0, 0."""
    if not is_unlike_along(term.form):
        return 0.0, 0.0
    return term.coefficients[2] / (2.0 * term.form.constants["half_span_mm"]), term.form.constants["centre_mm"]


def _zero_mm(term: Term) -> float | None:
    """Where growth·x + offset + bend·(x - centre)² is zero, nearest to where a straight growth would be; None where it is nowhere."""
    growth, offset = term.coefficients[0], term.coefficients[_offset_index(term)] / UM_PER_MM_PPM
    bend, centre = _bend(term)
    straight = -offset / growth
    if not bend:
        return straight
    roots = np.roots([bend, growth - 2.0 * bend * centre, offset + bend * centre**2])
    if np.any(np.iscomplex(roots)):
        return None
    return float(roots.real[np.argmin(np.abs(roots.real - straight))])


def fixed_point_mm(term: Term) -> Estimate | None:
    """The point about which the axis grows, with its first-order uncertainty; None for growth about zero, and where the
    growth there is not known well enough for a quotient by it.
    """
    growth = term.coefficient(0)
    if not is_about_a_point(term.form) or abs(growth.value) <= POINT_KNOWN_TO * growth.std:
        return None
    point = _zero_mm(term)
    if point is None:
        return None
    bend, centre = _bend(term)
    covariance = np.array(term.covariance)
    value, slope = np.zeros(len(covariance)), np.zeros(len(covariance))
    value[0], value[_offset_index(term)], slope[0] = point, 1.0 / UM_PER_MM_PPM, 1.0
    if is_unlike_along(term.form):
        half = term.form.constants["half_span_mm"]
        value[2], slope[2] = (point - centre) ** 2 / (2.0 * half), (point - centre) / half
    steep = growth.value + 2.0 * bend * (point - centre)
    if abs(steep) <= POINT_KNOWN_TO * math.sqrt(max(float(slope @ covariance @ slope), 0.0)):
        return None
    std = math.sqrt(max(float(value @ covariance @ value), 0.0)) / abs(steep)
    offset = _offset_index(term)
    ends = None if bend else term.range_of(lambda c, _: float(-c[offset] / UM_PER_MM_PPM / c[0]))
    return Estimate(point, std, ends)
