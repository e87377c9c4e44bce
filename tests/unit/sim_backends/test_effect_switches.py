"""Every effect of the catalogue can be switched on in a running machine, has the size it was asked for, and shows where it should."""

import itertools
import math
import statistics
from collections.abc import Callable, Iterator
from contextlib import closing

import pytest
from support.catalogue import NAMES

from drivers.errors import InputError
from sim_backends import laser_effects
from sim_backends.bench import Bench
from sim_backends.laser import LaserParameters, SimulatedLaser
from sim_backends.plant import switches
from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.parameters import geometric_axis, ideal_axis

SIZE_UM = 4.0


def go(axis: FeedAxis, *places_mm: float, speed_mm_s: float = 50.0) -> float:
    """Move, and rest; the true error there in µm."""
    for place in places_mm:
        start = axis.motor_mm
        steps = max(1, math.ceil(abs(place - start) / speed_mm_s / 0.1))
        for i in range(1, steps + 1):
            axis.step((start + (place - start) * i / steps) / 10.0, 0.1)
        axis.step(place / 10.0, 0.1)
    return axis.error_um


@pytest.fixture
def machine() -> Callable[..., float]:
    """difference(effect, what): what(axis with the effect) − what(axis without)."""

    def difference(effect: str, what: Callable[[FeedAxis], float]) -> float:
        plain, changed = (FeedAxis(geometric_axis(9)) for _ in range(2))
        for axis in (plain, changed):
            go(axis, 20.0, 10.0)
        switches.switch_on(changed, effect, SIZE_UM)
        return what(changed) - what(plain)

    return difference


def test_the_whole_catalogue_can_be_switched_on() -> None:
    assert sorted([*switches.SWITCHES, *laser_effects.SWITCHES]) == sorted(NAMES)
    with Bench() as bench:
        for effect in sorted(NAMES):
            bench.switch_on(effect, 1.0)
        bench.clock.sleep_s(1.0)
        with pytest.raises(InputError, match="'wear' cannot be switched on"):
            bench.switch_on("wear", 1.0)


def test_cyclic(machine: Callable[..., float]) -> None:
    differences = [machine("cyclic", lambda axis, x=x: go(axis, 100.0 + x / 4.0)) for x in range(80)]
    assert statistics.fmean(differences) == pytest.approx(0.0, abs=0.1 * SIZE_UM)
    assert 0.75 * SIZE_UM < max(differences) < 1.6 * SIZE_UM
    assert differences[:40] == pytest.approx(differences[40:], rel=0.3, abs=0.3)  # nearly periodic: it breathes
    assert differences[:40] != pytest.approx(differences[40:], abs=0.01)


def test_pitch_shape_and_abbe(machine: Callable[..., float]) -> None:
    for effect in ("pitch_shape", "abbe"):
        differences = [abs(machine(effect, lambda axis, x=x: go(axis, float(x)))) for x in range(0, 501, 10)]
        assert max(differences) == pytest.approx(SIZE_UM, rel=0.05)
        steps = [abs(b - a) for a, b in itertools.pairwise(differences)]
        assert max(steps) < 0.25 * SIZE_UM


def test_abbe_shows_in_the_level() -> None:
    axis = FeedAxis(ideal_axis())
    switches.switch_on(axis, "abbe", SIZE_UM)
    seen = [(go(axis, float(x)), axis.pitch_urad) for x in range(0, 501, 25)]
    arm_mm = axis.parameters.guideway.arm_z_mm
    assert [error for error, _ in seen] == pytest.approx([tilt * arm_mm * 1e-3 for _, tilt in seen], abs=0.1)


def two_sides(axis: FeedAxis, x_mm: float) -> float:
    forward = go(axis, x_mm - 40.0, x_mm)
    return go(axis, x_mm + 40.0, x_mm) - forward


def test_reversal_effects(machine: Callable[..., float]) -> None:
    assert machine("backlash", lambda axis: two_sides(axis, 250.0)) == pytest.approx(SIZE_UM, rel=0.01)
    assert machine("lost_motion", lambda axis: two_sides(axis, 250.0)) == pytest.approx(SIZE_UM, rel=0.01)
    assert machine("backlash_position", lambda axis: two_sides(axis, 250.0)) == pytest.approx(0.0, abs=0.02)
    assert machine("backlash_position", lambda axis: two_sides(axis, 450.0)) == pytest.approx(0.8 * SIZE_UM, rel=0.02)


def test_lost_motion_needs_distance(machine: Callable[..., float]) -> None:
    built = [machine("lost_motion", lambda axis, s=s: go(axis, 300.0, 300.0 - s)) for s in (0.02, 0.5, 2.0, 6.0, 20.0)]
    assert built == sorted(built)
    assert built[-1] - built[0] > 0.9 * SIZE_UM
    assert 0.3 < (built[2] - built[0]) / SIZE_UM < 0.75


def test_thermal_expansion_starts_from_nothing_and_follows_the_screw() -> None:
    axis = FeedAxis(geometric_axis(9))
    before = go(axis, 20.0, 480.0)
    switches.switch_on(axis, "thermal_expansion", SIZE_UM)
    assert axis.error_um == pytest.approx(before, abs=1e-6)
    start_c = axis.thermal.state.screw_c
    for _ in range(80):
        after = go(axis, 20.0, 480.0)
    rise = axis.thermal.state.screw_c - start_c
    assert rise > 1.0
    assert after - before == pytest.approx(SIZE_UM * 0.96 * rise / 3.0, rel=0.2)  # less: the base takes part, and lags
    assert axis.sensors.readings.temps_c["screw"] == pytest.approx(axis.thermal.state.screw_c, abs=0.3)


def test_thermal_drift_settles_at_its_size() -> None:
    axis = FeedAxis(geometric_axis(9))
    before = go(axis, 100.0)
    switches.switch_on(axis, "thermal_drift", SIZE_UM)
    assert axis.error_um == pytest.approx(before)
    seen = []
    for _ in range(10):
        axis.step(10.0, 300.0)
        seen.append(axis.error_um - before)
    assert seen == sorted(seen)
    assert seen[0] == pytest.approx(SIZE_UM * (1 - 2 / math.e), rel=0.02)  # two lags in series
    assert seen[-1] == pytest.approx(SIZE_UM, rel=0.01)


def test_datum_step_happens_now() -> None:
    axis = FeedAxis(geometric_axis(9))
    before = go(axis, 100.0)
    switches.switch_on(axis, "datum_step", SIZE_UM)
    axis.step(10.0, 0.1)
    assert axis.error_um - before > 0.85 * SIZE_UM
    axis.step(10.0, 1000.0)
    assert axis.error_um - before == pytest.approx(SIZE_UM, rel=0.01)


@pytest.fixture
def setup() -> Iterator[tuple[SimulatedLaser, FeedAxis]]:
    axis = FeedAxis(ideal_axis())
    with closing(SimulatedLaser(axis, LaserParameters(noise_um=0.0))) as laser:
        yield laser, axis


def reading_um(laser: SimulatedLaser, time_s: float) -> float:
    """Displacement at the air's true index, µm."""
    unit_um = laser.parameters.vacuum_wavelength_nm / 2.0 / 1000.0
    return laser.interferometer.units(time_s) * unit_um / laser.interferometer.index


def test_cosine_reads_short(setup: tuple[SimulatedLaser, FeedAxis]) -> None:
    laser, axis = setup
    go(axis, 500.0)
    before = reading_um(laser, 0.0)
    laser_effects.switch_on(laser, axis, "cosine", SIZE_UM)
    assert reading_um(laser, 0.0) - before == pytest.approx(-SIZE_UM, rel=1e-3)
    go(axis, 0.0)
    assert reading_um(laser, 0.0) == pytest.approx(0.0, abs=1e-6)


def test_dead_path_follows_the_air_and_not_the_place(setup: tuple[SimulatedLaser, FeedAxis]) -> None:
    laser, axis = setup
    laser_effects.switch_on(laser, axis, "dead_path", SIZE_UM)
    assert reading_um(laser, 0.0) == pytest.approx(0.0, abs=1e-6)
    pressures, shifts = [], []
    for _ in range(200):
        go(axis, *[axis.motor_mm] * 600)
        pressures.append((axis.ambient.pressure_hpa - 1013.25) * 0.27e-6 - (axis.ambient.air_c - 20.0) * 0.95e-6)
        shifts.append(reading_um(laser, axis.time_s))
    assert statistics.correlation(pressures, shifts) > 0.99
    assert 0.4 * SIZE_UM < statistics.pstdev(shifts) < 2.0 * SIZE_UM


def test_air_index_is_seen_in_the_air(setup: tuple[SimulatedLaser, FeedAxis]) -> None:
    laser, axis = setup
    go(axis, 500.0)
    laser_effects.switch_on(laser, axis, "air_index", 1.0)
    raw = []
    for _ in range(200):
        axis.step(50.0, 100.0)
        raw.append(laser.interferometer.units(axis.time_s) * laser.parameters.vacuum_wavelength_nm / 2000.0)
    assert 0.5 < statistics.pstdev(raw) < 2.0


def test_beam_drift_wanders_slowly_and_starts_from_nothing(setup: tuple[SimulatedLaser, FeedAxis]) -> None:
    laser, axis = setup
    laser_effects.switch_on(laser, axis, "beam_drift", SIZE_UM)
    drift = [reading_um(laser, float(t)) for t in range(20000)]
    assert abs(drift[0]) < 0.5 * SIZE_UM
    assert 0.4 * SIZE_UM < statistics.pstdev(drift) < 1.6 * SIZE_UM

    def change(lag: int) -> float:
        return statistics.pstdev([b - a for a, b in zip(drift, drift[lag:], strict=False)])

    # neither white (equal) nor a random walk (√10 each): in between, over two decades
    for lag in (10, 100):
        assert 1.05 < change(10 * lag) / change(lag) < 2.4
