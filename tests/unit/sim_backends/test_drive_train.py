"""The wound-up drive train: forces in balance, the published shape of the torque, load, clearance, and no torque in its truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support.torque_machines import PUBLISHED, PublishedMachine, laser_lost_motion_um, plant_of, torque_curve

from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.drive_train import DriveTrain, Guide, WindUp


@pytest.mark.parametrize("machine", PUBLISHED, ids=[machine.name for machine in PUBLISHED])
def test_the_table_loses_what_the_laser_found(machine: PublishedMachine) -> None:
    assert laser_lost_motion_um(machine.train, machine.load_kg) == pytest.approx(machine.laser_um, abs=0.05)


def test_lost_motion_is_that_of_springs_against_friction() -> None:
    """By hand: linear springs, 2·(F_screw + F_table)/k1 + 2·F_table/k2 + clearance."""
    train = DriveTrain(
        coupling_n_per_um=100.0, nut_n_per_um=50.0, hardening_per_um=0.0, gap_um=3.0, screw_friction_n=100.0
    )
    by_hand = 2 * (100.0 + 800.0) / 100.0 + 2 * 800.0 / 50.0 + 3.0
    assert laser_lost_motion_um(train) == pytest.approx(by_hand, rel=0.003)


@pytest.mark.parametrize("direction", [1, -1])
def test_torque_through_a_reversal_looks_like_the_published_curve(direction: int) -> None:
    """A residual after stopping; |T| falls through zero about half way, rises, peaks just beyond the lost motion, drops to sliding."""
    torque = direction * torque_curve(DriveTrain(), direction).steps_permille
    size = np.abs(torque)
    assert size[0] == pytest.approx(size[-1], rel=0.01)
    assert torque[0] < 0.0 < torque[-1]
    zero = int(np.argmin(size))
    assert 20 <= zero <= 28
    peak = int(np.argmax(size))
    assert 53 <= peak <= 56
    assert np.all(np.diff(size[1 : zero - 1]) < 0.0)
    assert np.all(np.diff(size[zero + 1 : peak]) > 0.0)
    assert size[peak] > 1.015 * size[-1]
    assert np.ptp(size[-20:]) < 0.1


def test_load_makes_friction_and_with_it_lost_motion() -> None:
    train = DriveTrain(guide=Guide(sliding_n=300.0, per_kg_n=0.04))
    bare, loaded = laser_lost_motion_um(train), laser_lost_motion_um(train, 15_000.0)
    assert 2.0 * bare < loaded < 3.0 * bare


def test_a_long_way_in_one_step_ends_as_in_many() -> None:
    coarse, fine = WindUp(DriveTrain(), 0.0), WindUp(DriveTrain(), 0.0)
    for index in range(1, 101):
        coarse.step(index * 0.005, 0.1, 0.0)
    for index in range(1, 1001):
        fine.step(index * 0.0005, 0.01, 0.0)
    for train in (coarse, fine):
        train.step(0.5, 2.0, 0.0)
    assert coarse.lag_um == pytest.approx(fine.lag_um, abs=0.05)


def test_at_rest_nothing_moves_and_rest_heals_the_bond() -> None:
    """The longer it rests the harder it is to break away."""
    peaks = []
    for rest_s in (0.02, 20.0):
        train = WindUp(DriveTrain(), 0.0)
        for index in range(1, 200):
            train.step(index / 1000.0, 0.01, 0.0)
        where = train.table_um
        train.step(0.199, rest_s, 0.0)
        assert train.table_um == pytest.approx(where, abs=0.2)
        forces = []
        for index in range(1, 40):
            train.step(0.199 + index / 10_000.0, 0.001, 0.0)
            forces.append(train.torque_permille)
        peaks.append(max(forces))
    assert peaks[1] > 1.02 * peaks[0]


def test_a_plant_without_one_is_as_it_was() -> None:
    rigid = FeedAxis(replace(plant_of(DriveTrain()), drive_train=None))
    rigid.step(1.0, 0.5)
    assert rigid.position_mm == pytest.approx(10.0, abs=1e-9)
    assert rigid.friction_permille == 0.0


def by_the_papers_equations(train: DriveTrain, up_um: float, speed_um_s: float) -> tuple[np.ndarray, np.ndarray]:
    """The same machine as differential equations in the paper's form, by a stiff solver: torque over travel after a reversal.

    xs, xt: screw and table; zs, zt: their bristles, z' = v − σ|v|z/g(v); b: the bond.
    """
    guide = train.guide
    turn_s = up_um / speed_um_s

    def motor_um(t: float) -> float:
        return speed_um_s * t if t <= turn_s else up_um - speed_um_s * (t - turn_s)

    def nut_n(stretch: float) -> float:
        return train.nut_n_per_um * stretch * (1.0 + train.hardening_per_um * abs(stretch))

    def rate(t: float, y: np.ndarray) -> list[float]:
        xs, xt, zs, zt, b = y
        spring = nut_n(xs - xt)
        vs = train.coupling_n_per_um * (motor_um(t) - xs) - spring - train.screw_bristle_n_per_um * zs
        vs /= train.screw_viscous_n_s_per_mm / 1000.0
        vt = (spring - guide.bristle_n_per_um * zt) / (guide.viscous_n_s_per_mm / 1000.0)
        stribeck = np.exp(-((vt / (1000.0 * guide.stribeck_mm_s)) ** 2))
        g = guide.sliding_n * (1.0 + guide.static_excess * b * stribeck)
        zs_rate = vs - train.screw_bristle_n_per_um * abs(vs) * zs / train.screw_friction_n
        zt_rate = vt - guide.bristle_n_per_um * abs(vt) * zt / g
        return [vs, vt, zs_rate, zt_rate, -abs(vt - zt_rate) * b / guide.bond_um + (1.0 - b) / guide.heal_s]

    travel = np.arange(0.0, 75.0, 0.5)
    times = turn_s + travel / speed_um_s
    out = solve_ivp(
        rate, (0.0, times[-1] + 0.01), [0, 0, 0, 0, 1.0], "BDF", t_eval=times, rtol=1e-6, atol=1e-7, max_step=0.02
    )
    xs = out.y[0]
    return travel, train.coupling_n_per_um * ((up_um - travel) - xs) * 1000.0 / train.rated_n


@pytest.mark.outside
def test_it_moves_as_the_papers_equations_say() -> None:
    train, speed = DriveTrain(), 100.0
    travel, expected = by_the_papers_equations(train, 100.0, speed)
    wound = WindUp(train, 0.0)
    step_um, dt_s = 0.5, 0.5 / speed
    for index in range(1, 201):
        wound.step(index * step_um / 1000.0, dt_s, 0.0)
    found = [wound.torque_permille]
    for um in travel[1:]:
        wound.step((100.0 - um) / 1000.0, dt_s, 0.0)
        found.append(wound.torque_permille)
    level = abs(float(expected[-1]))
    assert float(np.max(np.abs(np.array(found) - expected))) < 0.02 * level
    assert travel[int(np.argmin(found))] == pytest.approx(travel[int(np.argmin(expected))], abs=1.0)
