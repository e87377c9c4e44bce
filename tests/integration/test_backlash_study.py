"""The fitted wind-up against the published rule, on machines whose lost motion a simulated laser on the table tells.

Neither the plant (LuGre friction and two springs, integrated in time) nor the laser's truth shares code or a formula with the fit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.torque_machines import (
    NOISE_PERMILLE,
    PUBLISHED,
    PublishedMachine,
    laser_lost_motion_um,
    noisy_trace,
    some_train,
    torque_curve,
)

from hil.backlash.result import MeanLostMotion, Reversal, fitted_lost_motion, four_sample
from hil.backlash.trace import ReversalTrace

RULES, CAMPAIGNS = 200, 30
SEEDS, SEEDS_PER_MACHINE = 200, 4


def accuracy_percent(found_um: float | np.floating, laser_um: float) -> float:
    """As the patent counts it."""
    return 100.0 * (1.0 - abs(found_um - laser_um) / laser_um)


def peak(trace: ReversalTrace) -> float:
    found = four_sample(trace)
    assert found is not None
    return found


def lost_motion_of(reversals: list[Reversal]) -> MeanLostMotion:
    found = fitted_lost_motion(reversals)
    assert found is not None
    return found


@pytest.mark.outside
@pytest.mark.parametrize("noise_permille", [0.5, NOISE_PERMILLE, 1.5])
@pytest.mark.parametrize("machine", PUBLISHED, ids=[machine.name for machine in PUBLISHED])
def test_five_runs_on_machines_with_the_published_lost_motion(
    machine: PublishedMachine, noise_permille: float, record_property: Callable[[str, object], None]
) -> None:
    """Rule and fit on the same readings, in this noise: the fit at least 99 % every time. What the document states is its machines'
    result, to which nothing here is fitted."""
    curves = {d: torque_curve(machine.train, d, machine.load_kg, steps=100) for d in (-1, 1)}
    rng = np.random.default_rng(5)

    def trace(direction: int) -> ReversalTrace:
        return noisy_trace(curves[direction], noise_permille, rng)

    rule = [accuracy_percent(np.mean([peak(trace(-1)) for _ in range(5)]), machine.laser_um) for _ in range(RULES)]
    fit, covered = [], []
    for _ in range(CAMPAIGNS):
        found = lost_motion_of([Reversal.of(run, trace(d)) for run in range(1, 6) for d in (-1, 1)])
        fit.append(accuracy_percent(found.mean_um, machine.laser_um))
        covered.append(abs(found.mean_um - machine.laser_um) <= found.u95_um)
    record_property("document_percent", machine.published_accuracy_percent)
    record_property("rule_percent", f"{np.mean(rule):.2f}")
    record_property("fit_percent", f"{np.mean(fit):.2f}, worst {np.min(fit):.2f}")
    assert np.mean(rule) < np.min(fit)
    assert np.min(fit) >= 99.0
    assert np.mean(covered) >= 0.9


@pytest.mark.outside
def test_the_stated_uncertainty_covers_the_truth_on_machines_nobody_has_seen(
    record_property: Callable[[str, object], None],
) -> None:
    """20 to 90 µm, with and without a clearance, noise 0.5 to 1.5 in 0.1 % of rated: one run each way per seed."""
    covered, relative = [], []
    for machine_seed in range(SEEDS // SEEDS_PER_MACHINE):
        train = some_train(machine_seed)
        laser_um = laser_lost_motion_um(train)
        curves = {d: torque_curve(train, d, steps=int(1.5 * laser_um) + 25) for d in (-1, 1)}
        for index in range(SEEDS_PER_MACHINE):
            rng = np.random.default_rng(1000 * machine_seed + index)
            noise = rng.uniform(0.5, 1.5)
            found = lost_motion_of([Reversal.of(1, noisy_trace(curves[d], noise, rng)) for d in (-1, 1)])
            covered.append(abs(found.mean_um - laser_um) <= found.u95_um)
            relative.append(found.u95_um / laser_um)
    record_property("covered", f"{np.mean(covered):.3f} of {len(covered)}, U95 {100 * np.median(relative):.2f} %")
    assert len(covered) == SEEDS
    assert np.mean(covered) >= 0.9
    assert np.median(relative) < 0.02, "an uncertainty that covers everything says nothing"
