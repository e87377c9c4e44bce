"""Temperature rise as the thermal effects share it: a sensor, a sensor through a lag, or warming since the start.

The effects that use it decide how the axis responds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.effects.base import MOST_UNSURE, Columns, Estimate, Floats, Form, NonLinear, Term
from hil.effects.history import lagged, through
from hil.effects.survey import Survey

REFERENCE_C = 20.0
"""Reference temperature of geometrical product specifications, ISO 1."""
TEMPERATURE = "temperature"
LAGGED = "lagged temperature"
WARMING = "warming since the start"
SLOW_WARMING = "warming since the start through two lags"
SINCE_START = (WARMING, SLOW_WARMING)
ABOUT_A_POINT = ", about a fixed point"
"""End of the name of a form that grows about a point which is fitted."""
UNLIKE_ALONG = ", unlike along the travel"
"""Before that, in the name of a form whose growth changes along the travel: a screw is warmest where its nut works most."""
Rows = NDArray[np.bool_] | slice
ALL_ROWS = slice(None)
LATE = 0.25
"""Share of the time from the first row to the last by which the first comes after 0, from which on the time is counted from the first:
1 - e^(-t / τ) is nearly constant long after its start, and a clock's time has no start at all.
"""
FROM_THE_FIRST = "from_the_first"
"""Constant of a form that counts so."""
SEEN = ("least_rise_k", "most_rise_k")
"""Constants of a form by a temperature, where it is bounded: the least and the most of its rise that counts, K above 20 °C."""
LEAST_SEEN = 0.5
"""Share of a course that settles which must lie between the first row and the last for its final value to be stated: beyond
that it is an extrapolation.
"""
UNBOUNDED = 2.0
"""Standard uncertainty over the time constant from which no bound of it is stated: it would be a fiftieth, and is often 1e-14 s."""
GRID = 12
"""Time constants in the grid."""


def time_constants(survey: Survey) -> tuple[NonLinear, tuple[tuple[float, ...], ...]]:
    """Bounds and grid of a settling time constant for a campaign, s or rows: from a few rows to several times its
    length.

    The prior lies in the middle of the grid: a process that has hardly begun to settle looks like a straight line, and
    that would extrapolate without end.
    """
    low = max(4 * survey.interval_s, survey.duration_s / 60)
    high = max(3 * survey.duration_s, 4 * low)
    grid = tuple((float(value),) for value in np.geomspace(low, high, GRID))
    usual = (math.sqrt(low * high), math.log(high / low) / math.sqrt(12.0))
    return NonLinear("time_constant", low / 2, 2 * high, usual=usual), grid


def temperature_forms(
    effect: str, survey: Survey, extra_inputs: tuple[str, ...] = (), likely: tuple[str, ...] = ()
) -> tuple[Form, ...]:
    """One form per temperature column, one per column through a lag, and warming with time, by one lag or two (refinement).

    The columns share the effect's prior: it follows one of them, and the more there are, the better the best of them fits by chance.
    The lag belongs to the first search: a smooth course of time would fit better than the temperature it stands for.

    likely: columns that share half of the prior among themselves, as they are of the part that the effect is about
    """
    one_of = column_odds(survey, likely)
    forms = [Form(effect, TEMPERATURE, (name, *extra_inputs), log_odds=odds) for name, odds in one_of.items()]
    if survey.rows < 4 or not survey.has(survey.time_column):
        return tuple(forms)
    parameter, grid = time_constants(survey)
    inputs, rows = (survey.time_column, *extra_inputs), time_of_rows(survey)
    forms.append(Form(effect, WARMING, inputs, rows, nonlinear=(parameter,), starts=grid))
    forms.append(Form(effect, SLOW_WARMING, inputs, rows, nonlinear=(parameter,), starts=grid, scan=False))
    low, high = max(2 * survey.interval_s, survey.duration_s / 300), survey.duration_s
    lag = NonLinear("lag", low, high)
    starts = tuple((float(value),) for value in np.geomspace(low, high / 2, 6))
    forms.extend(
        Form(effect, LAGGED, (name, survey.time_column, *extra_inputs), {}, (lag,), starts, log_odds=odds)
        for name, odds in one_of.items()
    )
    return tuple(forms)


def column_odds(survey: Survey, likely: tuple[str, ...] = ()) -> dict[str, float]:
    """Prior log odds of each temperature among those that were logged: half of the prior to the likely ones, where there are any."""
    names = survey.warmth
    first = [name for name in names if name in likely]
    weight = {name: 1.0 / len(names) for name in names}
    if first and len(first) < len(names):
        weight = {name: 0.5 / (len(first) if name in first else len(names) - len(first)) for name in names}
    return {name: math.log(weight[name]) for name in names}


def time_of_rows(survey: Survey) -> dict[str, float]:
    """Time of the first and of the last row, as constants of a form, and whether it counts the time from the first."""
    late = {FROM_THE_FIRST: 1.0} if survey.time_start > LATE * survey.duration_s else {}
    return {"first_row": survey.time_start, "last_row": survey.time_start + survey.duration_s, **late}


@dataclass(frozen=True)
class Seen:
    """What the rows show of a course that settles: its change from the first row to the last, in the unit of the coefficient.

    determined: whether final value and time constant follow from the rows; else only the change, and this bound of the time
    constant, do; None where the time constant has none either
    """

    change: Estimate
    determined: bool
    at_least: float | None

    def bounds(self, unit: str) -> dict[str, Estimate]:
        """What is known of the time constant, as a parameter."""
        return {} if self.at_least is None else {f"least_time_constant_{unit}": Estimate(self.at_least, 0.0)}

    def open_end(self, unit: str) -> str:
        """What these rows do not determine, for an explanation."""
        beyond = "its time constant" if self.at_least is None else f"a time constant beyond {self.at_least:.3g} {unit}"
        return f"where it ends, and {beyond}, these rows do not determine"


def seen_in_rows(term: Term) -> Seen:
    """Of the first coefficient of a form that follows the time since the start."""
    c, tau = term.coefficient(0), term.nonlinear(0)
    k = len(term.coefficients)
    slow = term.form.name.removesuffix(ABOUT_A_POINT) == SLOW_WARMING
    times = [term.form.constants.get(name, default) for name, default in (("first_row", 0.0), ("last_row", math.inf))]
    if FROM_THE_FIRST in term.form.constants:
        times = [0.0, times[1] - times[0]]
    settled = [_settled(t, tau.value) for t in times]
    share, share_slope, second, second_slope = (b - a for a, b in zip(*settled, strict=True))
    gradient = np.zeros(k + len(term.theta))
    gradient[0], gradient[k] = share, c.value * share_slope
    if slow:
        gradient[1], gradient[k] = second, gradient[k] + term.coefficients[1] * second_slope
    variance = float(gradient @ np.array(term.covariance) @ gradient)
    change = _change(np.array(term.coefficients), tau.value, times, slow=slow)
    ends = term.range_of(lambda likely, theta: _change(likely, float(theta[0]), times, slow=slow))
    known = all(one.std < MOST_UNSURE * abs(one.value) for one in (c, tau)) and share >= LEAST_SEEN
    least = tau.value * math.exp(-2.0 * tau.std / tau.value) if tau.profiled is None else tau.profiled[0]
    bound = least if tau.std < UNBOUNDED * tau.value else None
    return Seen(Estimate(change, math.sqrt(max(variance, 0.0)), ends), known, bound)


def _change(coefficients: Floats, tau: float, times: Sequence[float], *, slow: bool) -> float:
    """Change of a course of these coefficients from the first time to the last."""
    (first, _, first_two, _), (last, _, last_two, _) = (_settled(t, tau) for t in times)
    change = coefficients[0] * (last - first)
    return float(change + coefficients[1] * (last_two - first_two) if slow else change)


def _settled(time: float, tau: float) -> tuple[float, float, float, float]:
    """At a time, 1 - e^(-x) and x·e^(-x) with x = time / tau, each with its derivative to tau."""
    x = time / tau
    left = math.exp(-x)
    if not math.isfinite(x):
        return 1.0, 0.0, 0.0, 0.0
    return 1.0 - left, -x * left / tau, x * left, -x * (1.0 - x) * left / tau


def since_start(form: Form, time: Floats) -> Floats:
    """The time since the start as a form counts it, shape of `time`, whose unit it has.

    Where the fitted rows came late (`LATE`): since the first of them, or since the first of these rows where those do not go on by the
    same clock; 0 before.
    """
    if FROM_THE_FIRST not in form.constants:
        return time
    first, low = form.constants["first_row"], float(np.min(time))
    return np.maximum(time - (first if low <= first <= float(np.max(time)) else low), 0.0)


def time_unit(term: Term) -> str:
    """'s', or 'rows' where the row order replaced the time."""
    return "rows" if "row_order" in term.form.inputs else "s"


def is_since_start(form: Form) -> bool:
    """Whether a form follows the time since the start and no sensor."""
    return form.name.removesuffix(ABOUT_A_POINT) in SINCE_START


def follows_a_temperature(form: Form) -> bool:
    """Whether a form follows a sensor's temperature, through a lag or not."""
    return _course(form) in (TEMPERATURE, LAGGED)


def is_about_a_point(form: Form) -> bool:
    """Whether a form grows about a point that is fitted."""
    return form.name.endswith(ABOUT_A_POINT)


def _course(form: Form) -> str:
    """Name of what a form follows: TEMPERATURE, LAGGED …"""
    end = UNLIKE_ALONG + ABOUT_A_POINT
    return form.name.removesuffix(end if form.name.endswith(end) else ABOUT_A_POINT)


def lag_of(form: Form, theta: Sequence[float]) -> tuple[str, float] | None:
    """The column that a form reads through a lag, and its time constant, s; None for another form."""
    return (form.inputs[0], theta[0]) if _course(form) == LAGGED and form.inputs[1] == "time_s" else None


def is_unlike_along(form: Form) -> bool:
    """Whether a form's growth changes along the travel."""
    return form.name.endswith(UNLIKE_ALONG + ABOUT_A_POINT)


def as_far_as_seen(term: Term, columns: Columns, rows: Rows = ALL_ROWS) -> Term:
    """A term by a temperature, the rise of which counts no further than on some rows of these columns, or than it did."""
    free = _unbounded(term.form)
    risen = rise(free, term.theta, columns)[rows]
    least, most = (term.form.constants.get(name, float(risen[0, 0])) for name in SEEN)
    bounds = min(least, float(np.min(risen))), max(most, float(np.max(risen)))
    return replace(term, form=replace(free, constants={**free.constants, **dict(zip(SEEN, bounds, strict=True))}))


def is_bounded(term: Term) -> bool:
    """Whether the rise of a term counts only as far as it was seen."""
    return SEEN[0] in term.form.constants


def goes_beyond_what_was_seen(term: Term, columns: Columns) -> NDArray[np.bool_]:
    """The rows of these columns, shape (n,), on which the temperature's rise is beyond the bound of a bounded term."""
    return np.asarray(rise(_unbounded(term.form), term.theta, columns) != rise(term.form, term.theta, columns))[:, 0]


def _unbounded(form: Form) -> Form:
    return replace(form, constants={name: value for name, value in form.constants.items() if name not in SEEN})


def rise(form: Form, theta: Sequence[float], columns: Columns) -> Floats:
    """The temperature rise of a form, shape (n, 1): K above 20 °C, no further than its constants `SEEN` where it has them; or
    the fraction of the final rise (0 … 1). Raises KeyError for another form.

    SLOW_WARMING has a second column, shape (n, 2), for heat that passes through a second mass.
    """
    name = _course(form)
    if name in SINCE_START:
        x = since_start(form, columns[form.inputs[0]]) / theta[0]
        settled = 1.0 - np.exp(-x)
        return settled[:, None] if name == WARMING else np.column_stack([settled, x * np.exp(-x)])
    values = columns[form.inputs[0]] - REFERENCE_C
    if name == LAGGED:
        now = columns.get(through(form.inputs[0], theta[0]))
        values = lagged(columns[form.inputs[1]], values, theta[0]) if now is None else now - REFERENCE_C
    elif name != TEMPERATURE:
        raise KeyError(form.name)
    if SEEN[0] in form.constants:
        least, most = (form.constants[name] for name in SEEN)
        values = np.clip(values, least, most)
    return np.asarray(values)[:, None]
