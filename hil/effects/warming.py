"""Temperature rise as the thermal effects share it: a sensor, a sensor through a lag, or warming since the start.

The effects that use it decide how the axis responds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.effects.base import Columns, Floats, Form, NonLinear, Term
from hil.effects.history import lagged
from hil.effects.survey import Survey

REFERENCE_C = 20.0
"""Reference temperature of geometrical product specifications, ISO 1."""
TEMPERATURE = "temperature"
LAGGED = "lagged temperature"
WARMING = "warming since the start"
SLOW_WARMING = "warming since the start through two lags"
SINCE_START = (WARMING, SLOW_WARMING)
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


def temperature_forms(effect: str, survey: Survey, extra_inputs: tuple[str, ...] = ()) -> tuple[Form, ...]:
    """One form per temperature column, one per column through a lag (refinement), and warming with time, by one lag or two."""
    forms = [Form(effect, TEMPERATURE, (name, *extra_inputs)) for name in survey.temperatures]
    if survey.rows < 4 or not survey.has(survey.time_column):
        return tuple(forms)
    parameter, grid = time_constants(survey)
    forms.append(Form(effect, WARMING, (survey.time_column, *extra_inputs), nonlinear=(parameter,), starts=grid))
    forms.append(
        Form(
            effect,
            SLOW_WARMING,
            (survey.time_column, *extra_inputs),
            nonlinear=(parameter,),
            starts=grid,
            scan=False,
        )
    )
    low, high = max(2 * survey.interval_s, survey.duration_s / 300), survey.duration_s
    lag = NonLinear("lag", low, high)
    starts = tuple((float(value),) for value in np.geomspace(low, high / 2, 6))
    forms.extend(
        Form(effect, LAGGED, (name, survey.time_column, *extra_inputs), nonlinear=(lag,), starts=starts, scan=False)
        for name in survey.temperatures
    )
    return tuple(forms)


def time_unit(term: Term) -> str:
    """'s', or 'rows' where the row order replaced the time."""
    return "rows" if "row_order" in term.form.inputs else "s"


def rise(form: Form, theta: Sequence[float], columns: Columns) -> Floats:
    """The temperature rise of a form, shape (n, 1): K above 20 °C, or the fraction of the final rise (0 … 1). Raises
    KeyError for another form.

    SLOW_WARMING has a second column, shape (n, 2), for heat that passes through a second mass.
    """
    if form.name in SINCE_START:
        x = columns[form.inputs[0]] / theta[0]
        settled = 1.0 - np.exp(-x)
        return settled[:, None] if form.name == WARMING else np.column_stack([settled, x * np.exp(-x)])
    values = columns[form.inputs[0]] - REFERENCE_C
    if form.name == LAGGED:
        values = lagged(columns[form.inputs[1]], values, theta[0])
    elif form.name != TEMPERATURE:
        raise KeyError(form.name)
    return np.asarray(values)[:, None]
