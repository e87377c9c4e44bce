"""The running form, fitted to one measured reversal of a simulated machine, against that machine through strokes of every length.

The machine's lost motion is a stack of stop elements: piecewise linear, no tanh in it, and it remembers its strokes by itself.
"""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np
import pytest

from hil.lost_motion.fit import MeasuredReversal, fit
from hil.lost_motion.published import TwoTanh
from hil.lost_motion.running import after_full_stroke, moved_to
from hil.lost_motion.shapes import TWO_TANH
from sim_backends.plant.hysteresis import Backlash, LostMotion, Reversal

MACHINES, SEQUENCES, STROKES = 50, 10, 30


def wound_up(lost: LostMotion) -> Reversal:
    """The machine at 0 after a long stroke in +."""
    machine = Reversal(Backlash(), lost)
    machine.step(-500.0)
    machine.step(0.0)
    return machine


def form_of(lost: LostMotion, distance_mm: float) -> TwoTanh:
    """One reversal + → −, measured densely where it begins and over more than twice the way it takes, with the table in force."""
    machine = wound_up(lost)
    travel_mm = 14.0 * distance_mm * np.linspace(0.0, 1.0, 300) ** 2
    error_um = []
    for travel in travel_mm.tolist():
        machine.step(-travel)
        error_um.append(-machine.loss_um)
    return fit(TWO_TANH, [MeasuredReversal(-1, travel_mm, np.array(error_um))], table=False).form


@pytest.mark.slow
def test_no_over_compensation_after_any_strokes(record_property: Callable[[str, object], None]) -> None:
    """500 sequences of 30 strokes each, from a thirtieth of the rise to sixteen times it."""
    over, off, forgetful = 0.0, 0.0, 0.0
    for seed in range(MACHINES):
        rng = random.Random(seed)
        amount_um, distance_mm = rng.uniform(5.0, 40.0), rng.uniform(0.3, 3.0)
        lost = LostMotion.spread(seed, amount_um, distance_mm)
        form = form_of(lost, distance_mm)
        for _ in range(SEQUENCES):
            machine, state, position_mm = wound_up(lost), after_full_stroke(0.0, 1), 0.0
            turn_mm = -500.0
            for _ in range(STROKES):
                before_mm, was = position_mm, state.direction
                position_mm += rng.choice([1, -1]) * distance_mm * 10 ** rng.uniform(-1.5, 1.2)
                machine.step(position_mm)
                state, correction_um = moved_to(form, state, position_mm)
                # the machine counts from the middle, the correction from the − side
                too_much = (correction_um - form.amount_um / 2.0 - machine.loss_um) / amount_um
                turn_mm = turn_mm if state.direction == was else before_mm
                if state.direction > 0:  # as if every stroke had been full
                    counted_um = form.risen_um(abs(position_mm - turn_mm)) - form.amount_um / 2.0
                    forgetful = max(forgetful, abs(counted_um - machine.loss_um) / amount_um)
                over, off = max(over, too_much * state.direction), max(off, abs(too_much))
    record_property("over-compensation, share of the lost motion", round(over, 4))
    record_property("largest error either way, share of the lost motion", round(off, 4))
    assert over <= 0.05
    assert off <= 0.06
    assert forgetful > 0.5  # the strokes are such that memory matters
