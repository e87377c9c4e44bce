"""Lost motion after a reversal: the table follows only after some travel; the error decays with the travel since the
reversal.

error = amount · d · f(s / length), f exponential or 1 - tanh, s = `since_reversal_mm`. The constant per direction that remains for
large s belongs to the table. Elements that stick and slip at different forces (Prandtl, Masing) remember strokes that were too short
to wind them up: error = amount · d · (f(s / length) - f(S₁ / length) + f(S₂ / length) - …), s the travel since the last reversal that
is remembered, S₁, S₂ … the strokes before it (`hil.effects.history.BRANCH`); where a loop closes it is the branch from before.
Where such strokes are among the rows, f may also be that of Dahl's friction model, whose force rises as dF/ds = (1 - F)^n / L: n = 1
is the exponential, n = 1/2 a parabola that ends, n = 2 a hyperbola (P. R. Dahl, AIAA Journal 14, 1976).
(A controller's two-stage running form is in `hil.lost_motion`, fitted to dense reversals.)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import MOST_UNSURE, Action, Columns, Effect, Estimate, Floats, Form, NonLinear, Rival, Term
from hil.effects.history import BRANCH, LONG_STROKE_MM, with_branches
from hil.effects.survey import Survey

EXPONENTIAL = "exponential"
TANH = "tanh"
TWO_STAGE = "two lengths"
DAHL = "Dahl"
REMEMBERED = {f"{name}, strokes remembered": name for name in (EXPONENTIAL, TANH, DAHL)}
"""Forms with the strokes before, and the form that each has after a long one."""
LEAST_EXPONENT, MOST_EXPONENT = -1.0, 3.0
"""Of Dahl's model: below 0 what is left ends abruptly, as after a gap, which elements that slip one after the other never make;
above 2 it has a long tail.
"""
EXPONENTS = (-0.5, 0.5, 2.0, 3.0)
SHORTEST = 1e-3
"""Least length that a search starts with, in travels, where rows lie closer to a reversal."""
ONE_STROKE = {"exponential, short strokes remembered": EXPONENTIAL, "tanh, short strokes remembered": TANH}
"""Of models stored before: the last stroke alone is remembered."""
NEARLY_ONE = 1e-6
"""Difference of Dahl's exponent from 1 within which the first term of a series counts."""
ENDED = 1e-12
"""What stands for 0 in a power, where the lost motion has ended."""
MOST_BEYOND = 3.0
"""Times what the row nearest to a reversal has, that an extrapolation to it may reach. Of 87 machines of the study one was wrong by
190 µm without a limit.
"""
SEEN_FROM = 0.9
"""Share of the amount that must be there at the shortest travel of the rows for the amount itself to be stated: what lies before
that travel is an extrapolation, so otherwise the value at it is stated.
"""


class LostMotion(Effect):
    """error_um = a·d·f(s/L), a in µm, s and L in mm, f(z) = e^(-z), 1 - tanh z or Dahl's; or a sum of two exponentials."""

    id: ClassVar[str] = "lost_motion"
    title: ClassVar[str] = "lost motion after a reversal"
    action: ClassVar[Action] = Action.COMPENSATE
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("backlash_position", "approach the same targets after different travel since the reversal"),
        Rival("backlash", "approach the same targets after different travel since the reversal"),
        Rival("velocity_lag", "approach the same targets at three feeds, at rest when captured"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        if not survey.has("since_reversal_mm", "direction"):
            return ()
        high = 2 * survey.half_span_mm
        nearest_mm = survey.ranges.get("since_reversal_mm", (0.0, 0.0))[0]
        low = survey.spacing_mm / 8
        if nearest_mm > 0.0:  # rows on the reversal itself show no length
            low = min(low, max(nearest_mm, SHORTEST * high))
        length = NonLinear("length_mm", low / 4, high)
        starts = tuple((float(value),) for value in np.geomspace(low, high / 2, 12))
        second = NonLinear("second_length_mm", low / 4, high)
        pairs = tuple((a[0], b[0]) for a in starts[::3] for b in starts[::3] if b[0] > 2 * a[0])
        inputs = ("since_reversal_mm", "direction")
        seen = {"shortest_mm": nearest_mm}
        forms = [Form(self.id, name, inputs, seen, (length,), starts) for name in (EXPONENTIAL, TANH)]
        forms.append(Form(self.id, TWO_STAGE, inputs, seen, (length, second), pairs, scan=False))
        if survey.has("stroke_mm") and survey.ranges.get("stroke_mm", (np.inf,))[0] < survey.half_span_mm:
            known = (*inputs, "stroke_mm", "target_mm")
            exponent = NonLinear("exponent", LEAST_EXPONENT, MOST_EXPONENT, logarithmic=False)
            both = tuple((start[0], n) for start in starts[::2] for n in EXPONENTS)
            for name, kind in REMEMBERED.items():
                theta, grid = ((length, exponent), both) if kind == DAHL else ((length,), starts)
                forms.append(Form(self.id, name, known, seen, theta, grid, scan=kind != DAHL))
        return tuple(forms)

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        s, d = columns["since_reversal_mm"], columns["direction"]
        nearest_mm = form.constants.get("shortest_mm", 0.0)
        if form.name in (EXPONENTIAL, TANH):
            return np.asarray(d * _seen(form.name, s, theta, nearest_mm))[:, None]
        if form.name in REMEMBERED:
            after_long, branch = REMEMBERED[form.name], with_branches(columns)
            left, sign = _seen(after_long, branch[BRANCH[0]], theta, nearest_mm), -1.0
            for name in BRANCH[1:]:
                left, sign = left + sign * _left(after_long, branch[name], theta), -sign
            return np.asarray(d * left)[:, None]
        if form.name in ONE_STROKE:
            after_long, stroke = ONE_STROKE[form.name], columns["stroke_mm"]
            left = _left(after_long, s, theta) - _left(after_long, stroke, theta)
            return np.asarray(d * np.maximum(left, 0.0))[:, None]
        if form.name == TWO_STAGE:
            return np.column_stack([d * _seen(EXPONENTIAL, s, (length,), nearest_mm) for length in theta])
        raise KeyError(form.name)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        amount, at_mm = shown_amount(term)
        if at_mm == 0.0:
            found = {"amount_um": amount}
        else:
            found = {"amount_at_shortest_travel_um": amount, "shortest_travel_mm": Estimate(at_mm, 0.0)}
        found |= term.positive(0, "length_mm")
        if term.form.name == TWO_STAGE:
            found |= term.positive(1, "second_length_mm")
        elif REMEMBERED.get(term.form.name) == DAHL:
            found["exponent"] = term.nonlinear(1)
        return found

    def explain(self, term: Term) -> str:
        amount, at_mm = shown_amount(term)
        where = f", {at_mm:.3g} mm after it," if at_mm else ""
        return (
            f"After a reversal{where} the table is off by {amount} µm (in the direction of motion), fading over"
            f" {term.positive_text(0, 'mm')} of travel ({term.form.name}): wind-up and friction not yet overcome."
        )


def _left(form: str, s: Floats, theta: Sequence[float]) -> Floats:
    """Share of the lost motion that is left after a travel s (mm), shape of s; theta: its length, mm, and Dahl's exponent."""
    z = s / theta[0]
    if form == TANH:
        return np.asarray(1.0 - np.tanh(z))
    if form == DAHL:
        bend = theta[1] - 1.0
        z = z * (1.0 - 0.5 * bend * z) if abs(bend) < NEARLY_ONE else np.log(np.maximum(1.0 + bend * z, ENDED)) / bend
    return np.asarray(np.exp(-z))


def _seen(form: str, s: Floats, theta: Sequence[float], nearest_mm: float) -> Floats:
    """The share that is left, at most MOST_BEYOND times that of the row nearest to a reversal: a length that no row shows would make
    190 µm of 4.
    """
    most = MOST_BEYOND * _left(form, np.array([nearest_mm]), theta)
    return np.asarray(np.minimum(_left(form, s, theta), most))


def shown_amount(term: Term) -> tuple[Estimate, float]:
    """The amount, µm, and the travel since the reversal that it is stated for, mm: 0, or the shortest of the rows."""
    nearest = term.form.constants.get("shortest_mm", 0.0)
    wound = {"direction": 1.0, "stroke_mm": LONG_STROKE_MM, **dict.fromkeys(BRANCH, LONG_STROKE_MM)}
    whole, seen = (term.at({"since_reversal_mm": s, **wound, BRANCH[0]: s}) for s in (0.0, nearest))
    if seen.value / (whole.value or 1.0) >= SEEN_FROM and whole.std <= MOST_UNSURE * abs(whole.value):
        return whole, 0.0
    return seen, nearest
