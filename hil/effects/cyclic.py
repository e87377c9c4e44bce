"""Cyclic error: a sine of the position, from screw, coupling, encoder or the interferometer's sub-division.

error = amplitude · sin(2π x / period + phase), x the target in mm, phase in rad. Refining forms add the second or third harmonic
(period / 2, period / 3), let the amplitude change along the travel, or both.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np

from hil.effects.base import COVERS, Action, Columns, Effect, Estimate, Floats, Form, NonLinear, Rival, Term, Wave
from hil.effects.survey import Survey

FUNDAMENTAL = "fundamental"
MODULATED = "amplitude changing along the travel"
PER_DIRECTION = "different in each direction"
SECOND, THIRD = "with second harmonic", "with third harmonic"
FORMS = {
    FUNDAMENTAL: (0, False),
    SECOND: (2, False),
    THIRD: (3, False),
    MODULATED: (0, True),
    f"{SECOND}, {MODULATED}": (2, True),
    f"{THIRD}, {MODULATED}": (3, True),
    PER_DIRECTION: (0, False),
}
"""Of each form the order of the harmonic beside the fundamental, 0 for none, and whether the fundamental changes along the travel."""
ORDINAL = {2: "second", 3: "third"}

LINES = 1500
"""Most frequencies of the even scan."""
OVERSAMPLING = 3.0
"""Frequencies scanned per reciprocal of the travel."""
SHORTEST_MM = 0.5
"""Shortest period of the even scan on a travel of at least `LEAST_TURNS` such periods; on a shorter one that part of the travel."""
LEAST_TURNS = 20
INTERFERENCE_MM = 632.9908e-6 / 2.0
"""Period of the signal of a laser interferometer that reads its target once: half the vacuum wavelength of the helium-neon laser
(Mise en pratique of the metre, iodine-stabilised at 633 nm). Air shortens it by 0.03 %.
"""
HIGHEST_ORDER = 8
"""Periods per period of the signal up to which one is put down to the interferometer: beyond, any short period is near such a part."""
SAME_PERIOD = 0.02
"""Relative difference below which two periods are one, at least: of one turn of measured signals 1.1 %, where 0.9 % is stated;
neighbouring orders differ by an eighth and more."""
MOST_BEATS = 2.0
"""Periods over the travel with which the amplitude of one cycle may change: the search finds cycles as far from it then."""
DECADE, FAR_ABOVE = 10.0, 3.0
"""Ends of an interval, over one another and over the value, beyond which only the upper one is stated."""
COMMON_MM = (0.5, 1.0, 2.0, 2.5, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 25.0, 32.0, 40.0)
"""Common screw pitches and scale periods, tried beside the even scan."""


def period_grid(survey: Survey) -> tuple[tuple[float, ...], ...]:
    """Periods to scan in mm, ascending, each as a one-element tuple: even in frequency, finer than the travel resolves,
    at most `LINES` and the common ones.
    """
    travel = 2 * survey.half_span_mm
    longest = travel / 2
    step = 1.0 / (OVERSAMPLING * travel)
    shortest = min(SHORTEST_MM, travel / LEAST_TURNS)
    count = int(min(LINES, (1.0 / shortest - 1.0 / longest) / step))
    if count < 2:
        return ()
    frequencies = 1.0 / longest + step * np.arange(count)
    periods = [float(1.0 / f) for f in frequencies]
    known = {*COMMON_MM, *survey.pitches_mm, *(p / 2 for p in survey.pitches_mm)}
    periods.extend(p for p in known if p < longest)
    return tuple((p,) for p in sorted(set(periods)))


class Cyclic(Effect):
    """error_um = A·sin(2π·x/p + φ), A in µm, period p in mm, x the target in mm, φ in rad."""

    id: ClassVar[str] = "cyclic"
    title: ClassVar[str] = "cyclic error of screw, coupling or encoder"
    action: ClassVar[Action] = Action.COMPENSATE
    static: ClassVar[bool] = True
    several: ClassVar[bool] = True
    rivals: ClassVar[tuple[Rival, ...]] = (
        Rival("pitch_shape", "a dense sweep over two periods, and targets at random offsets from the pitch"),
        Rival("local_wear", "a dense sweep over two periods somewhere else on the travel"),
    )

    def forms(self, survey: Survey) -> tuple[Form, ...]:
        grid = period_grid(survey)
        if not grid:
            return ()
        period = NonLinear("period_mm", min(grid)[0] / 2, survey.half_span_mm)  # twice in the travel, or it is no cycle
        constants = {"centre_mm": survey.centre_mm, "half_span_mm": survey.half_span_mm}
        inputs = ("target_mm",)
        return tuple(
            Form(
                self.id,
                name,
                (*inputs, "direction") if name == PER_DIRECTION else inputs,
                constants if changes else {},
                (period,),
                grid,
                scan=name == FUNDAMENTAL,
            )
            for name, (_, changes) in FORMS.items()
        )

    def basis(self, form: Form, theta: Sequence[float], columns: Columns) -> Floats:
        return self.bases(form, [theta], columns)

    def bases(self, form: Form, thetas: Sequence[Sequence[float]], columns: Columns) -> Floats:
        order, changes = FORMS[form.name]
        x = columns["target_mm"][:, None]
        angle = 2 * np.pi * x / np.array(thetas)[:, 0]
        pairs = [1, order] if order else [1]
        waves = np.empty((*angle.shape, 2 * (len(pairs) + (changes or form.name == PER_DIRECTION))))
        for i, one in enumerate(pairs):
            np.sin(one * angle, out=waves[..., 2 * i])
            np.cos(one * angle, out=waves[..., 2 * i + 1])
        if changes:
            u = (x - form.constants["centre_mm"]) / form.constants["half_span_mm"]
            np.multiply(u[..., None], waves[..., :2], out=waves[..., -2:])
        elif form.name == PER_DIRECTION:
            np.multiply(columns["direction"][:, None, None], waves[..., :2], out=waves[..., -2:])
        return waves.reshape(len(angle), -1)

    def wave(
        self, form: Form, theta: Sequence[float], coefficients: Sequence[float], row: Mapping[str, float]
    ) -> Wave | None:
        per_mm = 2 * math.pi / theta[0]
        order, changes = FORMS[form.name]
        sine, cosine = coefficients[:2]
        if form.name == PER_DIRECTION:
            sine, cosine = sine + row["direction"] * coefficients[2], cosine + row["direction"] * coefficients[3]
        first = _wave(per_mm, sine, cosine)
        if order:
            first = _both(first, _wave(order * per_mm, *coefficients[2:4]))
        if not changes:
            return first
        change = _wave(per_mm, *coefficients[-2:])
        centre, half_span = form.constants["centre_mm"], form.constants["half_span_mm"]
        return Wave(lambda x: first.at_um(x) + (x - centre) / half_span * change.at_um(x), math.inf)

    def parameters(self, term: Term) -> dict[str, Estimate]:
        size = term.amplitude(0, 1)
        amplitude = {"amplitude_um": size} if is_known(size) else {"most_amplitude_um": Estimate(size.interval[1], 0.0)}
        found = {"period_mm": period_mm(term), **amplitude, "phase": term.angle(0, 1)}
        order, changes = FORMS[term.form.name]
        if order:
            found[f"{ORDINAL[order]}_harmonic_um"] = term.amplitude(2, 3)
        if changes:
            whole, coefficients = 2.0 * math.pi, np.array(term.coefficients)
            phase = math.remainder(_phase(term.form, coefficients, term.theta[0]), whole)
            found["phase"] = term.derived(
                lambda c, theta: phase + math.remainder(_phase(term.form, c, float(theta[0])) - phase, whole)
            )
            found["change_to_the_ends_um"] = term.derived(lambda c, _: _along(c)[0]).size
        elif term.form.name == PER_DIRECTION:
            found["half_difference_um"] = term.amplitude(2, 3)
        return found

    def action_for(self, term: Term) -> Action:
        return self.action if order_of_interference(term) is None else Action.FIX_SETUP

    def explain_all(self, terms: Sequence[Term]) -> str:
        parts = parts_that_turn(terms)
        return " ".join(
            text for part in parts for text in (self.explain(part[0]), *([_others(part)] if len(part) > 1 else []))
        )

    def explain(self, term: Term) -> str:
        extra = "" if term.form.name == FUNDAMENTAL else f", {term.form.name}"
        order = order_of_interference(term)
        if order is None:
            part = "a part that turns or divides with that period is eccentric or misadjusted"
        else:
            part = (
                f"order {order} of half the wavelength of a helium-neon laser, so the interferometer itself divides unevenly"
                " (offsets, gains and phase of its two signals, stray light)"
            )
        size = term.amplitude(0, 1)
        amplitude = f"{size} µm" if is_known(size) else f"at most {size.interval[1]:.3g} µm"
        return (
            f"The error repeats every {period_mm(term)} mm of travel with an amplitude of {amplitude}{extra}: {part}."
        )


def is_known(size: Estimate) -> bool:
    """Whether the rows determine a size: its interval spans no decade, and does not end far above it."""
    low, high = size.interval
    return high <= DECADE * max(low, 0.0) or high <= FAR_ABOVE * size.value


def parts_that_turn(terms: Sequence[Term]) -> list[list[Term]]:
    """The terms by the part that makes them, its longest cycle first: neighbouring periods are one cycle whose amplitude changes along
    the travel, the strongest first, and whole fractions of one period are harmonics.
    """
    cycles: list[list[Term]] = []
    for term in sorted(terms, key=lambda one: -one.amplitude(0, 1).value):
        first = next((cycle for cycle in cycles if _periods_apart(term, cycle[0]) <= MOST_BEATS), None)
        cycles.append([term]) if first is None else first.append(term)
    parts: list[list[Term]] = []
    for cycle in sorted(cycles, key=lambda one: -period_mm(one[0]).value):
        whole = next((part for part in parts if _is_harmonic(cycle[0], part[0])), None)
        parts.append(cycle) if whole is None else whole.extend(cycle)
    return parts


def _periods_apart(one: Term, other: Term, order: int = 1) -> float:
    """Periods over the travel that one term has more or fewer than a harmonic of another."""
    travel = 2.0 * one.form.nonlinear[0].upper
    return travel * abs(1.0 / period_mm(one).value - order / period_mm(other).value)


def _is_harmonic(term: Term, first: Term) -> bool:
    """Whether the period of a term is a whole fraction of another's, as far as travel and rows tell."""
    own, whole = period_mm(term), period_mm(first)
    order = round(whole.value / own.value)
    if not 1 <= order <= HIGHEST_ORDER:
        return False
    travel = 2.0 * term.form.nonlinear[0].upper
    unsure = travel * COVERS * math.hypot(own.std / own.value**2, order * whole.std / whole.value**2)
    return _periods_apart(term, first, order) <= max(1.0, min(unsure, SAME_PERIOD * travel / own.value))


def _wave(per_mm: float, sine: float, cosine: float) -> Wave:
    """sine · sin(per_mm · x) + cosine · cos(per_mm · x), as one sine."""
    size, phase, sin = math.hypot(sine, cosine), math.atan2(cosine, sine), math.sin
    return Wave(lambda x: size * sin(per_mm * x + phase), per_mm * size)


def _others(part: Sequence[Term]) -> str:
    """The further terms of a part in a sentence."""
    told = " and ".join(f"{period_mm(one)} mm ({one.amplitude(0, 1)} µm)" for one in part[1:])
    return f"Of the same part: {told}, harmonics of it or a change of its amplitude along the travel."


def _both(first: Wave, second: Wave) -> Wave:
    """The sum of two waves."""
    return Wave(lambda x: first.at_um(x) + second.at_um(x), first.steepest + second.steepest)


def period_mm(term: Term) -> Estimate:
    """The period at mid-travel.

    Where the amplitude changes along the travel, both waves have a change of their own: that of the phase is a change of the
    period, and only the two together are determined.
    """
    if not FORMS[term.form.name][1]:
        return term.nonlinear(0)
    return term.derived(lambda c, theta: _period(term.form, c, float(theta[0])))


def order_of_interference(term: Term) -> int | None:
    """Periods of a term per half wavelength of a helium-neon laser, where that is a whole number of them; else None."""
    period = period_mm(term)
    order = round(INTERFERENCE_MM / period.value)
    if not 1 <= order <= HIGHEST_ORDER:
        return None
    off_mm = abs(INTERFERENCE_MM / order - period.value)
    return order if off_mm <= max(SAME_PERIOD * period.value, 2.0 * period.std) else None


def _along(coefficients: Floats) -> tuple[float, float]:
    """Change of amplitude (µm) and of phase (rad) from mid-travel to its end, of an amplitude that changes along the travel."""
    size = math.hypot(coefficients[0], coefficients[1])
    change = coefficients[-2:]
    in_phase = float(coefficients[:2] @ change) / size
    across = float(coefficients[0] * change[1] - coefficients[1] * change[0]) / size
    return in_phase, across / size


def _period(form: Form, coefficients: Floats, period: float) -> float:
    turns = 1.0 / period + _along(coefficients)[1] / (2.0 * math.pi * form.constants["half_span_mm"])
    return 1.0 / turns


def _phase(form: Form, coefficients: Floats, period: float) -> float:
    """Phase at x = 0 of a wave of the period at mid-travel."""
    turns = 1.0 / period - 1.0 / _period(form, coefficients, period)
    return math.atan2(coefficients[1], coefficients[0]) + 2.0 * math.pi * form.constants["centre_mm"] * turns
