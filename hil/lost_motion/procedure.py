"""Lost motion after a reversal, by the axis's instrument (system C): measured, fitted, put into force, proven.

1. Strokes to and fro over one stretch, uncorrected, at rest at increasing distances after each turning point, and at
the same positions on the way back.
2. The difference at a position between arriving soon after a reversal and after a long stroke is the lost motion: the
error of the position is in both.
3. A rise fitted over the load's travel: two tanh terms, or another shape that is better by more than the noise on held-out strokes.
4. Moves of any length over the same stretch, with the earlier correction and with the rise added: the proof. The moves without the
rise were not fitted: another shape than two tanh terms stays only if it would have left less of them, too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError, StateError
from hil.axis.lost_motion import LostMotionConfig
from hil.correction.compensation import Compensation
from hil.correction.rise import TWO_TANH, Rise, RiseShape
from hil.correction.running_lost_motion import Turns, wound_um
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet
from hil.effects.base import Term
from hil.effects.history import remembered
from hil.figures.error_figures import rms
from hil.lost_motion.estimate import ReversalFit, Uncertain, estimate, with_two_tanh
from hil.lost_motion.fit import MeasuredReversal
from hil.machine.computing import Computing, at_once
from hil.machine.events import Event, Listener, silent
from hil.machine.measure import Step, measure
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import Floats, Records

RESIDUAL_SHARE = 0.05
"""Largest residual (RMS) and largest over-compensation, as a share of the lost motion, at which the result may be
stored, unless noise explains more.
"""
NOISE_FACTOR = 3.5
"""Standard deviations of noise that the largest of about forty rows may reach."""
COVERAGE = 2.0
"""k: a correction is stored only if it leaves less than before by more than so many standard uncertainties of the difference."""
TABLE_MISMATCH_SHARE = 0.15
"""Allowed difference between the lost motion and the tables' difference of directions, as a share; beyond it the tables
are refused.
"""


class NoLostMotionError(StateError):
    """There is nothing to correct: no lost motion shows above the noise, and nothing that is stored corrects one."""


@dataclass(frozen=True)
class Stretch:
    """The errors of position: position_mm and error_um, both (n,), of the axis half-way between its two directions;
    noise_um: standard deviation of one reading, from repeats.
    """

    position_mm: Floats
    error_um: Floats
    noise_um: float

    def at_um(self, position_mm: Floats) -> Floats:
        """The error at positions in mm, linear between, µm, shape as given."""
        return np.interp(position_mm, self.position_mm, self.error_um)


@dataclass(frozen=True)
class LostMotionProof:
    """The same moves before and after. before_um, after_um: remaining lost motion in each row, in the axis's sign."""

    before: Records
    after: Records
    before_um: Floats
    after_um: Floats
    amount_um: float
    noise_um: float

    @property
    def over_um(self) -> float:
        """The largest over-compensation after: too far in the direction of the last motion."""
        return max(0.0, float(np.max(self.after_um * self.after.direction)))

    @property
    def improvement_um(self) -> Uncertain:
        """By how much the RMS of the moves fell."""
        return gain_um(self.before_um, self.after_um)

    @property
    def improves(self) -> bool:
        """The moves show less lost motion than before, by more than the uncertainty of the difference (`COVERAGE`)."""
        return is_gain(self.improvement_um)

    def _within(self, left_um: Floats) -> bool:
        over_um = float(np.max(left_um * self.after.direction))
        return max(rms(left_um), over_um) <= max(RESIDUAL_SHARE * self.amount_um, NOISE_FACTOR * self.noise_um)

    @property
    def good(self) -> bool:
        """Residual and over-compensation are within `RESIDUAL_SHARE` or the noise, and it is an improvement."""
        return self._within(self.after_um) and self.improves

    @property
    def needless(self) -> bool:
        """It is no improvement, and none is needed: the moves before were within the limits already."""
        return self._within(self.before_um) and not self.improves


@dataclass(frozen=True)
class LostMotionResult:
    """The result. compensation: with the rise in force, to be stored where the proof is good."""

    records: Records
    estimate: ReversalFit
    stretch: Stretch
    compensation: Compensation
    proof: LostMotionProof

    @property
    def good(self) -> bool:
        """To be stored: the proof is good and the strokes were long enough."""
        return self.proof.good and not self.estimate.still_rising

    @property
    def needless(self) -> bool:
        """What is in force does as well, and stays."""
        return self.proof.needless and not self.estimate.still_rising


def gain_um(before_um: Floats, after_um: Floats) -> Uncertain:
    """By how much the RMS of the same moves is less after than before. The uncertainty is that of the mean of the differences of their
    squares, so what both have in common does not count.
    """
    both = rms(before_um) + rms(after_um)
    differences = before_um**2 - after_um**2
    if both == 0.0:
        return Uncertain(0.0, 0.0)
    std = float(np.std(differences, ddof=1)) / math.sqrt(len(differences))
    return Uncertain(float(np.mean(differences)) / both, std / both)


def is_gain(found: Uncertain) -> bool:
    """Whether a gain is larger than its expanded uncertainty (`COVERAGE`)."""
    return found.value > COVERAGE * found.std


# -- what is measured ----------------------------------------------------------------------------------------------------


def stroke_steps(how: LostMotionConfig) -> list[Step]:
    """Steps to and fro over the stretch: `run` is the number of the stroke. The first goes down after a whole stroke
    up.
    """
    low, high = how.low_mm, how.high_mm
    near_low = [low, *(round(low + travel, 6) for travel in how.travels_mm)]
    near_high = [high, *(round(high - travel, 6) for travel in how.travels_mm)]
    up = [*near_low[1:], *reversed(near_high)]
    down = [*near_high[1:], *reversed(near_low)]
    steps = [Step(1, -1, down[0], round(down[0] - low, 6)), *(Step(1, -1, target, 0.0) for target in down[1:])]
    # the first turning point has no measured stroke before it and is not used
    for stroke in range(2, 2 * how.runs + 2):
        direction, targets = (1, up) if stroke % 2 == 0 else (-1, down)
        steps += [Step(stroke, direction, target, 0.0) for target in targets]
    return steps


def proof_steps(how: LostMotionConfig, seed: int) -> list[Step]:
    """Moves between positions, of all lengths; each reverses or continues the one before it."""
    rng = np.random.default_rng([seed, 5])
    low, high, travels = how.low_mm, how.high_mm, how.travels_mm
    places = np.unique(np.round([low, high, *(low + np.array(travels)), *(high - np.array(travels))], 6))
    here = 0  # index of the place where the axis stands
    steps = [Step(1, -1, float(places[0]), round(high - low, 6))]
    while len(steps) <= how.proof_moves:
        reach = int(np.ceil(len(places) ** rng.uniform(0.0, 1.0)))  # as many short moves as long ones
        there = int(np.clip(here + rng.choice([-1, 1]) * reach, 0, len(places) - 1))
        if there != here:
            direction = 1 if there > here else -1
            steps.append(Step(1, direction, float(places[there]), 0.0))
            here = there
    return steps


# -- what it shows -------------------------------------------------------------------------------------------------------


def reversals_of(records: Records, how: LostMotionConfig) -> list[MeasuredReversal]:
    """One reversal per turning point between two strokes: the error at each position against that in the stroke
    before.
    """
    found = []
    for stroke in range(2, int(records.run.max()) + 1):
        before, after = records.where(records.run == stroke - 1), records.where(records.run == stroke)
        direction = int(after.direction[0])
        turning_mm = float(before.target_mm[-1])
        was = dict(zip(np.round(before.target_mm, 6).tolist(), before.error_um.tolist(), strict=True))
        travel, error = [0.0], [0.0]
        for target, now in zip(np.round(after.target_mm, 6).tolist(), after.error_um.tolist(), strict=True):
            if abs(target - turning_mm) < how.stroke_mm / 2.0:
                travel.append(abs(target - turning_mm))
                error.append(now - was[target])
        found.append(MeasuredReversal(direction, np.array(travel), np.array(error)))
    return found


def stretch_of(records: Records, how: LostMotionConfig, amount_um: float = 0.0) -> Stretch:
    """The errors of position, from the rows that came after a long stroke. The noise does not depend on the lost motion,
    amount_um: each place is reached from one side.
    """
    target, direction = np.round(records.target_mm, 6), records.direction
    long = np.where(direction > 0, target > how.at_mm, target < how.at_mm)
    middle_um = records.error_um + direction * amount_um / 2.0
    places = np.unique(target)
    means, squares, degrees = [], 0.0, 0
    for place in places:
        values = middle_um[long & (target == place)]
        means.append(float(values.mean()))
        squares += float(np.sum((values - values.mean()) ** 2))
        degrees += len(values) - 1
    return Stretch(places, np.array(means), math.sqrt(squares / max(1, degrees)))


def with_rise(
    present: Compensation | None, found: ReversalFit, how: LostMotionConfig, reach: tuple[float, float]
) -> Compensation:
    """The compensation to be put into force: the present tables, and the rise between their two directions.

    Without tables: the lost motion alone, as tables whose + direction is 0 (that of the datum). A fitted effect of the
    same cause is left out, as it would count twice. Raises InputError where the tables' directions differ by something
    else than the measured lost motion.
    """
    if present is None or _is_lost_motion_alone(present):
        nodes = np.array(reach)
        backlash = SingleTable(nodes, np.full(2, found.amount_um))
        zero = DirectionalTable.constant(nodes, 0.0)
        return Compensation(TableSet(TableMode.UNIDIRECTIONAL_BACKLASH, zero, backlash), (), found.rise)
    plus, minus = (float(present.tables.correction_um([how.at_mm], sign)[0]) for sign in (1, -1))
    if abs(plus - minus - found.amount_um) > TABLE_MISMATCH_SHARE * found.amount_um + 1.0:
        raise InputError(
            f"the tables in force hold a reversal of {plus - minus:.1f} µm at {how.at_mm:g} mm, measured now are"
            f" {found.amount_um:.1f} µm: calibrate again first"
        )
    terms = tuple(t for t in present.terms if not (isinstance(t, Term) and t.effect.id == "lost_motion"))
    return Compensation(present.tables, terms, found.rise)


def _nothing_to_correct(
    present: Compensation | None, found: ReversalFit, stretch: Stretch, how: LostMotionConfig
) -> StateError:
    """The error for an axis that loses nothing at its reversals; another one where what is stored corrects a reversal."""
    seen = f"{found.amount_um:.2f} µm with a noise of {stretch.noise_um:.2f} µm"
    stored_um = 0.0
    if present is not None:
        plus, minus = (float(present.tables.correction_um([how.at_mm], sign)[0]) for sign in (1, -1))
        stored_um = abs(plus - minus)
    if stored_um > NOISE_FACTOR * stretch.noise_um + found.amount_um:
        return StateError(
            f"no lost motion is left, {seen}, but what is stored corrects a reversal of {stored_um:.2f} µm at"
            f" {how.at_mm:g} mm: calibrate again, or remove it"
        )
    return NoLostMotionError(f"no lost motion to correct: {seen}; nothing was stored, and nothing needs to be")


def _is_lost_motion_alone(present: Compensation) -> bool:
    """Whether these tables came from an earlier measurement of this kind and hold nothing else."""
    tables = present.tables
    other = (tables.specified, tables.straightness)
    return (
        tables.mode is TableMode.UNIDIRECTIONAL_BACKLASH
        and other == (None, None)
        and not present.terms
        and not np.any(tables.pitch.plus_um)
    )


def residual_um(records: Records, stretch: Stretch, in_force: Compensation | None) -> Floats:
    """Remaining lost motion in each row, µm, (n,): its error, less that of its position and the mean correction of the
    tables there.
    """
    own = stretch.at_um(records.target_mm)
    if in_force is not None:
        plus, minus = (in_force.tables.correction_um(records.target_mm, sign) for sign in (1, -1))
        own = own + (plus + minus) / 2.0
    return np.asarray(records.error_um - own)


def left_by_um(rise: Rise, uncorrected: Records, stretch: Stretch) -> Floats:
    """Lost motion that a rise would have left in each move, µm, (n,). uncorrected: moves of the proof, the first after a full
    stroke in −; their error is counted without the correction in force then.
    """
    here_mm, turns, wound = float(uncorrected.target_mm[0]), Turns(), [0.0]
    direction = -1
    for target_mm in uncorrected.target_mm[1:].tolist():
        turns = remembered(turns, here_mm, direction, target_mm)
        here_mm, direction = target_mm, 1 if target_mm > here_mm else -1
        wound.append(wound_um(rise, here_mm, direction, turns))
    lost_um = uncorrected.uncorrected_error_um - stretch.at_um(uncorrected.target_mm)
    return np.asarray(lost_um + np.array(wound) - rise.amount_um / 2.0)


def confirmed(found: ReversalFit, uncorrected: Records, stretch: Stretch) -> ReversalFit:
    """The estimate itself; with two tanh terms in place of another shape that would not have left less of these moves."""
    if found.asked_for or found.rise.shape is TWO_TANH:
        return found
    two_tanh = with_two_tanh(found)
    left = [left_by_um(one.rise, uncorrected, stretch) for one in (two_tanh, found)]
    return found if is_gain(gain_um(*left)) else two_tanh


# -- the whole of it -----------------------------------------------------------------------------------------------------


def measure_lost_motion(
    session: AxisSession,
    campaign: Campaign,
    how: LostMotionConfig,
    present: Compensation | None,
    listener: Listener = silent,
    *,
    seed: int = 1,
    asked: RiseShape | Rise | None = None,
    computing: Computing = at_once,
) -> LostMotionResult:
    """Measures, fits and proves on a prepared session. present: the compensation in force, None for none. Stores
    nothing.

    Afterwards no compensation is in force in the session, also after an error. An interrupted campaign continues
    with its first missing row. asked: as `estimate` has it; computing: how the fit is run. Raises
    NoLostMotionError where no lost motion shows above the noise, InputError where the tables do not agree with it,
    CorrectionBoundError where the correction exceeds the axis's bound, and what stops the axis.
    """
    try:
        session.compensation = None
        records = measure(session, campaign, "strokes", stroke_steps(how), listener)
        listener(Event("fit"))
        reversals = reversals_of(records, how)
        noise_um = stretch_of(records, how).noise_um
        found = computing(session, lambda: estimate(reversals, how.shortest_rise_um / 1000.0, asked, noise_um))
        stretch = stretch_of(records, how, found.amount_um)
        if found.amount_um < NOISE_FACTOR * stretch.noise_um:
            raise _nothing_to_correct(present, found, stretch, how)
        _usable(session, present, found, how)
        steps = proof_steps(how, seed)
        session.compensation = present
        before = measure(session, campaign, "before", steps, listener)
        found = confirmed(found, before, stretch)
        stretch = stretch_of(records, how, found.amount_um)
        session.compensation = extended = _usable(session, present, found, how)
        after = measure(session, campaign, "after", steps, listener)
        left = (residual_um(before, stretch, present), residual_um(after, stretch, extended))
        proof = LostMotionProof(before, after, *left, found.amount_um, stretch.noise_um)
        return LostMotionResult(records, found, stretch, extended, proof)
    finally:
        session.compensation = None


def _usable(
    session: AxisSession, present: Compensation | None, found: ReversalFit, how: LostMotionConfig
) -> Compensation:
    """The compensation with this rise, held against the tables and the axis's bound."""
    limits = session.drive.limits
    extended = with_rise(present, found, how, (limits.travel_min_mm, limits.travel_max_mm))
    extended.check(session.command_state.bound, "correction by the lost motion measured not used")
    return extended


def _first(result: LostMotionResult) -> str:
    """What to do before lost motion is measured on an axis whose stored correction holds fitted effects."""
    effects = ", ".join(t.effect.id for t in result.compensation.terms if isinstance(t, Term))
    return (
        f"what is stored also corrects {effects}, fitted with a reversal of their own: first calibrate again (hil calibrate), which"
        " stores tables alone, then measure the lost motion, then close the loop for the rest"
    )


def verdict(result: LostMotionResult) -> Sequence[str]:
    """Sentences on what is wrong with the result; empty for a good one."""
    found, proof = result.estimate, result.proof
    said = []
    if found.still_rising:
        said.append(
            f"{found.late_um:.2f} µm of {found.amount_um:.2f} µm came back over the second half of the places:"
            " the strokes are too short for the whole lost motion (stroke_mm)"
        )
    left = f"{rms(proof.before_um):.2f} µm RMS before, {rms(proof.after_um):.2f} after"
    if not proof.improves:
        gain = proof.improvement_um
        do = (
            "what is in force stays, nothing has to be done"
            if proof.needless
            else _first(result)
            if result.compensation.terms
            else "look for what changes at the axis, then measure again with more runs and proof_moves"
        )
        said.append(
            f"no proven improvement, so nothing is stored: {left}, a gain of {gain.value:.3f} ± {COVERAGE * gain.std:.3f} µm (k = 2);"
            f" {do}"
        )
    elif not proof.good and result.compensation.terms:
        said.append(f"the correction is not proven: {left}; {_first(result)}")
    elif not proof.good:
        said.append(
            f"the correction is not proven: {left}, {proof.over_um:.2f} µm over-compensated at worst;"
            " measure again with more places and runs, and strokes where the axis works (at_mm)"
        )
    return said
