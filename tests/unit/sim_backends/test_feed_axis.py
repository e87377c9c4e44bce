"""The axis put together: what acts on what, signs, independence of step length, determinism."""

from dataclasses import replace

import pytest

from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.guideway import CrossAxis, Guideway, LoadDeflection, MountSlip, VelocityLag
from sim_backends.plant.hysteresis import Backlash, LostMotion
from sim_backends.plant.parameters import PlantParameters, geometric_axis, ideal_axis, typical_axis
from sim_backends.plant.screw import CyclicError, LocalWear, Screw
from sim_backends.plant.shapes import SmoothShape
from sim_backends.plant.thermal import ThermalParameters


def moved(axis: FeedAxis, *places_mm: float, speed_mm_s: float = 50.0, dt_s: float = 0.01) -> FeedAxis:
    lead = axis.parameters.screw.lead_mm
    at = axis.motor_mm
    for place in places_mm:
        steps = max(1, round(abs(place - at) / speed_mm_s / dt_s))
        for i in range(1, steps + 1):
            axis.step((at + (place - at) * i / steps) / lead, dt_s)
        at = place
        axis.step(place / lead, dt_s)
    return axis


def error_at(parameters: PlantParameters, *places_mm: float) -> float:
    return moved(FeedAxis(parameters), *places_mm).error_um


IDEAL = ideal_axis()


def test_an_ideal_axis_has_no_error() -> None:
    assert error_at(IDEAL, 100.0, 30.0, 499.0) == pytest.approx(0.0, abs=1e-9)


def test_backlash_leaves_the_table_behind() -> None:
    machine = replace(IDEAL, backlash=Backlash(6.0))
    assert error_at(machine, 100.0) == pytest.approx(-3.0)
    assert error_at(machine, 200.0, 100.0) == pytest.approx(3.0)


def test_cyclic_error_repeats_with_the_lead() -> None:
    machine = replace(IDEAL, screw=Screw(10.0, cyclic=CyclicError(2.0, 10.0)))
    assert error_at(machine, 102.5) == pytest.approx(2.0)
    assert error_at(machine, 107.5) == pytest.approx(-2.0)
    assert error_at(machine, 110.0) == pytest.approx(0.0, abs=1e-9)


def test_pitch_error_belongs_to_the_place_and_expansion_to_the_heat() -> None:
    pitch = SmoothShape.random(3, 10.0, 500.0)
    warm = ThermalParameters(expansion_ppm_per_k=10.0, start_screw_rise_k=4.0, base_share=0.0)
    machine = replace(IDEAL, screw=Screw(10.0, pitch), thermal=warm)
    axis = moved(FeedAxis(machine), 300.0)
    rise = axis.thermal.state.screw_c - 20.0
    assert 3.9 < rise < 4.0  # it has cooled a little on the way
    assert axis.error_um == pytest.approx(pitch.value(300.0) + 300.0 * 10e-3 * rise, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "expected_um"),
    [
        ({"screw": Screw(wear=LocalWear(5.0, 250.0, 20.0))}, -5.0),
        ({"guideway": Guideway(pitch_urad=SmoothShape(0.1), arm_z_mm=200.0)}, 25e-6 * 200.0 * 1000.0),
        ({"guideway": Guideway(yaw_urad=SmoothShape(0.1), arm_y_mm=100.0)}, -25e-6 * 100.0 * 1000.0),
        ({"slip": MountSlip(7.0, at_s=0.0, settling=0.0)}, 7.0),
        ({"slip": MountSlip(7.0, at_s=1e6)}, 0.0),
    ],
)
def test_terms_of_the_place_and_of_the_moment(change: dict[str, object], expected_um: float) -> None:
    assert error_at(replace(IDEAL, **change), 250.0) == pytest.approx(expected_um, rel=1e-3, abs=1e-6)  # type: ignore[arg-type]


def test_load_and_other_axis_and_speed_act_only_while_they_are_there() -> None:
    machine = replace(
        IDEAL,
        load=LoadDeflection(3.0, growth=0.0),
        cross_axis=CrossAxis(0.02, bow=0.0, growth=0.0),
        velocity_lag=VelocityLag(0.05),
    )
    axis = moved(FeedAxis(machine), 100.0)
    assert axis.error_um == pytest.approx(0.0, abs=1e-9)
    axis.load_kg = 300.0
    assert axis.error_um == pytest.approx(-3.0 * 3.0 / 1.2)
    axis.load_kg = 0.0
    axis.other_axis_mm = 100.0
    assert axis.error_um == pytest.approx(2.0)
    axis.other_axis_mm = 0.0
    axis.step(10.1, 0.02)  # 1 mm in 20 ms
    assert axis.error_um == pytest.approx(-0.05 * 50.0, rel=0.01)
    axis.step(10.1, 0.02)
    assert axis.error_um == pytest.approx(0.0, abs=1e-9)


def test_load_winds_the_drive_up_further() -> None:
    axis = FeedAxis(replace(IDEAL, backlash=Backlash(10.0), load=LoadDeflection(windup_per_100kg=0.1)))
    axis.load_kg = 200.0
    assert moved(axis, 50.0).error_um == pytest.approx(-6.0)


def test_length_of_steps_does_not_matter() -> None:
    places = (120.0, 37.0, 410.0, 405.0, 409.0)
    fine = moved(FeedAxis(geometric_axis(4)), *places, dt_s=0.002)
    coarse = moved(FeedAxis(geometric_axis(4)), *places, dt_s=0.5)
    assert coarse.position_mm == pytest.approx(fine.position_mm, abs=1e-9)


def test_one_seed_is_one_machine() -> None:
    first, second, other = (moved(FeedAxis(typical_axis(s)), 300.0, 100.0) for s in (5, 5, 6))
    assert first.position_mm == second.position_mm
    assert first.sensors.readings == second.sensors.readings
    assert first.position_mm != other.position_mm


def test_thermometers_are_near_the_truth_and_noisy() -> None:
    axis = FeedAxis(typical_axis(2))
    seen = []
    for _ in range(2000):
        axis.step(0.0, 0.5)
        seen.append(axis.sensors.readings.temps_c["base"] - axis.thermal.state.base_c)
    mean = sum(seen) / len(seen)
    std = (sum((s - mean) ** 2 for s in seen) / len(seen)) ** 0.5
    assert abs(mean) < 0.002
    assert 0.01 < std < 0.02


def test_parameters_may_be_exchanged_at_any_time_and_states_stay() -> None:
    axis = moved(FeedAxis(geometric_axis(4)), 200.0)
    before = axis.error_um
    axis.reconfigure(replace(axis.parameters, lost_motion=LostMotion.spread(1, 4.0, 0.5)))
    assert axis.error_um == pytest.approx(before)  # nothing has moved yet
    moved(axis, 190.0, 200.0)
    assert axis.error_um == pytest.approx(before - 2.0, abs=0.05)
