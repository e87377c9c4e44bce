"""Faces, angles, bosses and reference positions: formulas by hand, then on virtual drives against the simulated geometry.

What is expected is where the simulated walls and bosses stand; their truth (a sphere against solids) shares no code with what is
tested.
"""

from __future__ import annotations

import cmath
import math
import random
from pathlib import Path
from typing import Any

import pytest
from support import probe_files
from support.probe_files import connected_probe

from drivers.errors import InputError
from hil.probe.machine_file import ProbeMachineConfig, load_probe_machine
from hil.probe.procedure import FeatureMeasurement, centre_bore, correct, measure_feature, measure_run_out
from hil.probe.runout import Ball, CorrectionCode, RunOut, Touch, boss_mm
from hil.probe.session import UnexpectedContactError
from hil.probe.wiring import probe_bench
from sim_backends.plant.touch_probe import Bore, Boss, Face, Solid, Stylus, Wall
from sim_backends.probe import ProbeParameters
from sim_backends.probe_bench import ProbeBench

ANGLES = (0.0, 30.0, 90.0, 217.0)
STYLUS = Stylus(2.0, (0.030, -0.012), pretravel_mm=0.004)
KNOWN = RunOut(0.030, -0.012, 2.0)
# the ball's centre 0.030, −0.012 mm off the axis, turned by hand: cos and sin of 30° are 0.866025 and 0.5, of 217° −0.798636 and
# −0.601815
OFFSETS_UM = {0.0: (30.0, -12.0), 30.0: (31.980762, 4.607695), 90.0: (12.0, 30.0), 217.0: (-31.180845, -8.470824)}


# -- formulas ----------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("spindle_deg", ANGLES)
def test_a_face_by_hand_at_each_angle(spindle_deg: float) -> None:
    """A ball of 2 mm less 4 µm of pre-travel, met by feeding x in + direction at 100 mm, and y in − direction at 50 mm."""
    ball = Ball.of(KNOWN, spindle_deg, 0.004)
    x_um, y_um = OFFSETS_UM[spindle_deg]
    assert ball.face_mm(Touch("x", 1, (100.0, 7.0))) == pytest.approx(101.996 + x_um / 1000, abs=1e-8)
    assert ball.face_mm(Touch("y", -1, (7.0, 50.0))) == pytest.approx(48.004 + y_um / 1000, abs=1e-8)
    assert ball.uncorrected.face_mm(Touch("x", 1, (100.0, 7.0))) == pytest.approx(101.996)


def test_an_inclined_face_by_hand() -> None:
    """3-4-5: contacts 4 mm apart and 3 mm deeper; the face is 2·5/4 mm behind the line of the ball's centres."""
    ball = Ball((0.0, 0.0), 2.0)
    first, second = Touch("x", 1, (10.0, 20.0)), Touch("x", 1, (13.0, 24.0))
    assert ball.inclined_face_mm(first, second, 20.0) == pytest.approx(12.5)
    assert ball.inclined_face_mm(first, second, 22.0) == pytest.approx(14.0)
    assert ball.angle_deg(first, second) == pytest.approx(-math.degrees(math.atan2(3, 4)))
    assert ball.angle_deg(second, first) == pytest.approx(-math.degrees(math.atan2(3, 4)))
    along_x = Touch("y", 1, (20.0, 10.0)), Touch("y", 1, (24.0, 13.0))
    assert ball.angle_deg(*along_x) == pytest.approx(math.degrees(math.atan2(3, 4)))
    away = Ball((0.1, -0.2), 2.0)
    assert away.angle_deg(first, second) == ball.angle_deg(first, second)  # the run-out is the same at both
    assert away.inclined_face_mm(first, second, 20.0) == pytest.approx(12.5 + 0.1 + 0.2 * 3 / 4)


def test_a_boss_by_hand() -> None:
    ball = Ball((0.030, -0.012), 2.0)
    assert boss_mm(ball, Touch("x", 1, (37.0, 0.0)), Touch("x", -1, (61.0, 0.0))) == pytest.approx((49.03, 20.0))


# -- on the machine ------------------------------------------------------------------------------------------------------------
SECTIONS = """
[face]
axis = "y"
x_mm = 20.0
y_mm = 30.0
direction = -1
search_mm = 1.0
{z}

[angle]
axis = "x"
x_mm = 20.0
y_mm = 20.0
direction = 1
search_mm = 1.0
apart_mm = -12.0
{z}

[boss]
x_mm = 80.0
y_mm = 80.0
clear_mm = 9.0
search_mm = 2.0
{z}

[reference]
x_from_mm = [20.0, 55.0]
x_direction = 1
y_from_mm = [30.0, 46.0]
y_direction = 1
search_mm = 1.0
nominal_mm = [22.5, 48.5]
{z}
"""


def load(tmp_path: Path, *, z: bool = False, **more: Any) -> ProbeMachineConfig:
    sections = SECTIONS.format(z="z_mm = 30.0" if z else "")
    probe = "pretravel_mm = 0.004\nposition_mm_s = 50.0"
    given = {"start_mm": 102.7, "search_mm": 0.6, "probe": probe, "block": "turns = 1", "z": z, "more": sections}
    return load_probe_machine(probe_files.lay_out(tmp_path, **{**given, **more}))


def measured(
    config: ProbeMachineConfig, name: str, *solids: Solid, spindle_deg: float | None = None, mode: str = "latch"
) -> tuple[FeatureMeasurement, ProbeBench]:
    bench = probe_bench(config, ProbeParameters(STYLUS, solids), feature=name)
    before = {axis: bench.place(axis) for axis in config.axes}
    with connected_probe(config, touching=("x", "y"), bench=bench, mode=mode) as session:
        found = measure_feature(session, KNOWN, name, spindle_deg=spindle_deg)
    assert {axis: bench.place(axis) for axis in config.axes} == pytest.approx(before, abs=1e-3)
    assert bench.probe.deepest_mm < 0.2
    return found, bench


@pytest.mark.parametrize("spindle_deg", ANGLES)
def test_a_single_face(tmp_path: Path, spindle_deg: float) -> None:
    found, _ = measured(load(tmp_path), "face", Wall((20.0, 27.4321, 0.0), 90.0), spindle_deg=spindle_deg)
    assert found.corrected["face_mm"] == pytest.approx(27.4321, abs=1e-4)
    assert found.spindle_deg == pytest.approx(spindle_deg, abs=1e-3)
    off_um = 1000 * (found.uncorrected["face_mm"] - 27.4321)
    assert off_um == pytest.approx(-OFFSETS_UM[spindle_deg][1], abs=0.1)  # what it is there for


@pytest.mark.parametrize("spindle_deg", ANGLES)
@pytest.mark.parametrize("tilt_deg", [-0.8, 0.0, 0.45])
def test_the_angle_of_a_face(tmp_path: Path, spindle_deg: float, tilt_deg: float) -> None:
    """A face across x, approached in + direction, about (22.5, 14); contacts at y = 20 and 8."""
    found, _ = measured(
        load(tmp_path), "angle", Wall((22.5, 14.0, 0.0), 180.0 + tilt_deg, half_width_mm=30.0), spindle_deg=spindle_deg
    )
    assert found.corrected["angle_deg"] == pytest.approx(tilt_deg, abs=0.002)  # 0.4 µm over 12 mm
    assert found.corrected["across_mm"] == pytest.approx(14.0, abs=1e-3)
    assert found.corrected["face_mm"] == pytest.approx(22.5, abs=2e-4)
    x_um, y_um = OFFSETS_UM[spindle_deg]
    off_um = 1000 * (found.uncorrected["face_mm"] - 22.5)
    assert off_um == pytest.approx(-x_um - y_um * math.tan(math.radians(tilt_deg)), abs=0.2)


@pytest.mark.parametrize("spindle_deg", ANGLES)
def test_a_boss_is_gone_round_and_comes_out(tmp_path: Path, spindle_deg: float) -> None:
    found, bench = measured(load(tmp_path), "boss", Boss((80.21, 79.83, 0.0), 6.02), spindle_deg=spindle_deg)
    truth = {"x_mm": 80.21, "y_mm": 79.83, "width_y_mm": 12.04}
    assert {name: found.corrected[name] for name in truth} == pytest.approx(truth, abs=2e-4)
    chord_mm = 2.0 * math.sqrt((6.02 + 2.0 - 0.004) ** 2 - (80.0 + OFFSETS_UM[spindle_deg][1] / 1000 - 79.83) ** 2)
    assert found.corrected["width_x_mm"] == pytest.approx(chord_mm - 2.0 * (2.0 - 0.004), abs=3e-4)
    off_um = [1000 * (found.uncorrected[name] - truth[name]) for name in ("x_mm", "y_mm")]
    assert off_um == pytest.approx([-one for one in OFFSETS_UM[spindle_deg]], abs=0.3)
    assert bench.probe.touches == 4


@pytest.mark.parametrize("spindle_deg", ANGLES)
def test_a_reference_position_at_an_outer_corner(tmp_path: Path, spindle_deg: float) -> None:
    """The block lies at x > 22.53, y > 48.46: both contacts are at faces that the other one's way must not cross."""
    walls = Wall((22.53, 68.46, 0.0), 180.0, 20.0), Wall((42.53, 48.46, 0.0), 270.0, 20.0)
    found, _ = measured(load(tmp_path), "reference", *walls, spindle_deg=spindle_deg)
    assert (found.corrected["x_mm"], found.corrected["y_mm"]) == pytest.approx((22.53, 48.46), abs=1e-4)
    assert (found.corrected["off_x_um"], found.corrected["off_y_um"]) == pytest.approx((30.0, -40.0), abs=0.1)
    off_um = found.uncorrected["off_x_um"] - 30.0, found.uncorrected["off_y_um"] + 40.0
    assert off_um == pytest.approx([-one for one in OFFSETS_UM[spindle_deg]], abs=0.1)


def test_by_pulses_within_one(tmp_path: Path) -> None:
    config = load(tmp_path)
    found, _ = measured(config, "face", Wall((20.0, 27.95, 0.0), 90.0), spindle_deg=30.0, mode="step")
    assert found.corrected["face_mm"] == pytest.approx(27.95, abs=1e-3)


@pytest.mark.outside
def test_fifty_machines_measure_with_the_run_out_that_they_found(tmp_path: Path) -> None:
    """From M90 to each feature, at any angle, with pre-travel, noise and a spindle whose zero is anywhere."""
    worst_um = uncorrected_um = 0.0
    for seed in range(50):
        rng = random.Random(seed)
        zero_deg, sense, spindle_deg = rng.uniform(-80, 80), rng.choice((1, -1)), rng.choice(ANGLES)
        config = load(tmp_path, spindle=f"zero_deg = {zero_deg!r}\nsense = {sense}", start_mm=102.6, search_mm=1.0)
        offset = rng.uniform(0.01, 0.08) * cmath.exp(1j * rng.uniform(0, 2 * math.pi))
        stylus = Stylus(rng.uniform(1.9, 2.1), (offset.real, offset.imag), 0.004, rng.uniform(0, 0.0002))
        block = ProbeParameters(stylus, (Face((105.0, 40.0, 0.0)),), seed=seed)
        with connected_probe(config, bench=probe_bench(config, block)) as session:
            known = measure_run_out(session).run_out
        at = 27.0 + rng.uniform(0.2, 0.8), 80.0 + rng.uniform(-0.3, 0.3), 80.0 + rng.uniform(-0.3, 0.3)
        solids: dict[str, Solid] = {"face": Wall((20.0, at[0], 0.0), 90.0), "boss": Boss((*at[1:], 0.0), 6.0)}
        for name, solid in solids.items():
            bench = probe_bench(config, ProbeParameters(stylus, (solid,), seed=seed), feature=name)
            with connected_probe(config, touching=("x", "y"), bench=bench) as session:
                found = measure_feature(session, known, name, spindle_deg=spindle_deg)
            true = {"face_mm": at[0]} if name == "face" else {"x_mm": at[1], "y_mm": at[2], "width_y_mm": 12.0}
            worst_um = max(worst_um, *(1000 * abs(found.corrected[key] - value) for key, value in true.items()))
            uncorrected_um = max(
                uncorrected_um, *(1000 * abs(found.uncorrected[key] - value) for key, value in true.items())
            )
    assert worst_um <= 1.0
    assert uncorrected_um > 50.0
    print(f"other measurements: worst {worst_um:.3f} µm, without correction {uncorrected_um:.1f} µm")


# -- the correction and the bore at any angle --------------------------------------------------------------------------------------
@pytest.mark.parametrize("spindle_deg", ANGLES)
def test_a_correction_is_driven_at_each_angle(tmp_path: Path, spindle_deg: float) -> None:
    config = load(tmp_path)
    bench = probe_bench(config, ProbeParameters(STYLUS), in_bore=True)
    with connected_probe(config, touching=("x", "y"), bench=bench) as session:
        session.prepare()
        session.orient(spindle_deg)
        correct(session, KNOWN, CorrectionCode.M93)
    moved_um = 1000 * (bench.place("x") - 50.0), 1000 * (bench.place("y") - 60.0)
    assert moved_um == pytest.approx(OFFSETS_UM[spindle_deg], abs=0.05)


@pytest.mark.parametrize("spindle_deg", ANGLES)
def test_a_bore_is_centred_at_each_angle(tmp_path: Path, spindle_deg: float) -> None:
    config = load(tmp_path)
    bench = probe_bench(config, ProbeParameters(STYLUS, (Bore((50.05, 59.98, 0.0), 6.0),)), in_bore=True)
    with connected_probe(config, touching=("x", "y"), bench=bench) as session:
        session.prepare()
        session.orient(spindle_deg)
        found = centre_bore(session, KNOWN, CorrectionCode.M93)
    assert (bench.place("x"), bench.place("y")) == pytest.approx((50.05, 59.98), abs=2e-4)
    assert found.centring.diameter_mm == pytest.approx(12.0, abs=2e-4)


# -- Z -----------------------------------------------------------------------------------------------------------------------------
def test_z_is_raised_between_places_and_lowered_to_measure(tmp_path: Path) -> None:
    """A rail of 36 mm height stands between the block's place and the face's; 40 mm is safe, 30 mm is where it is measured."""
    config = load(tmp_path, z=True)
    rail = Wall((50.0, 38.0, 0.0), 90.0, half_width_mm=200.0, depth_mm=4.0, top_mm=36.0)
    face = Wall((20.0, 27.4321, 0.0), 90.0, top_mm=35.0)
    bench = probe_bench(config, ProbeParameters(STYLUS, (rail, face)))
    before = {axis: bench.place(axis) for axis in config.axes}
    assert before["z"] == pytest.approx(40.0)
    lowest: list[float] = []
    bench.clock.attach(lambda _now_ns, _dt_s: lowest.append(bench.place("z")))
    with connected_probe(config, touching=("x", "y"), bench=bench) as session:
        found = measure_feature(session, KNOWN, "face", spindle_deg=30.0)
    assert found.corrected["face_mm"] == pytest.approx(27.4321, abs=1e-4)
    assert {axis: bench.place(axis) for axis in config.axes} == pytest.approx(before, abs=1e-3)
    assert min(lowest) == pytest.approx(30.0, abs=0.01)


def test_something_under_the_ball_stops_z_on_its_way_down(tmp_path: Path) -> None:
    config = load(tmp_path, z=True)
    below = Wall((20.0, 40.0, 0.0), 90.0, half_width_mm=50.0, depth_mm=30.0, top_mm=32.0)  # the ball touches at 34 mm
    bench = probe_bench(config, ProbeParameters(STYLUS, (below,)), feature="face")
    with (
        connected_probe(config, touching=("x", "y"), bench=bench) as session,
        pytest.raises(UnexpectedContactError, match=r"touched at Z = 33\.9\d\d mm|touched at Z = 34\.0\d\d mm"),
    ):
        measure_feature(session, KNOWN, "face")
    assert bench.place("z") == pytest.approx(33.95, abs=0.1)
    assert bench.probe.deepest_mm < 0.1
    assert not any(servo.powered for servo in bench.servos.values())


def test_run_out_and_bore_are_approached_in_z(tmp_path: Path) -> None:
    config = load(tmp_path, z=True)
    ring = Bore((50.05, 59.98, 0.0), 6.0)
    truth = ProbeParameters(STYLUS, (Wall((105.0, 40.0, 0.0), 180.0, top_mm=33.0), ring))
    bench = probe_bench(config, truth)
    with connected_probe(config, bench=bench) as session:
        known = measure_run_out(session).run_out
    assert (known.x_mm, known.y_mm, known.tip_radius_mm) == pytest.approx((0.030, -0.012, 2.0), abs=2e-4)
    assert bench.place("z") == pytest.approx(40.0, abs=1e-3)
    bench = probe_bench(config, truth, in_bore=True)
    with connected_probe(config, touching=("x", "y"), bench=bench) as session:
        centre_bore(session, known, CorrectionCode.M93)
    assert (bench.place("x"), bench.place("y"), bench.place("z")) == pytest.approx((50.05, 59.98, 30.0), abs=1e-3)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("safe_mm = 40.0", "safe_mm = 140.0", "safe_mm leads axis Z out of its limits"),
        ("z_mm = 30.0", "z_mm = -60.0", "z_mm leads axis Z out of its limits"),
        ("[approach]\nsafe_mm = 40.0\n", "", "expected .approach. safe_mm beside it"),
        ("z_mm = 30.0", "", r"\[block\] has no z_mm, which a machine with a z axis needs|block.*has no z_mm"),
        ('z = "Z.toml"', "", "z_mm is given, but .machine. names no z axis"),
        ("safe_mm = 40.0", "safe_mm = 40.0\nlower_mm_s = 1000.0", "lower_mm_s is 1000, expected at most 100"),
        ("apart_mm = -12.0", "apart_mm = 0.0", "expected a distance between both contacts"),
        ("apart_mm = -12.0", "apart_mm = -30.0", "search_mm leads axis Y out of its limits"),
        ("clear_mm = 9.0", "clear_mm = 1.0", "search_mm is 2, expected less than clear_mm, 1"),
        ("clear_mm = 9.0", "clear_mm = 90.0", "x_mm leads axis X out of its limits"),
        ("x_from_mm = [20.0, 55.0]", "x_from_mm = [200.0, 55.0]", "x_from_mm leads axis X out of its limits"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_connected(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = load(tmp_path, z=True).path
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        load_probe_machine(path)


def test_a_feature_that_the_file_does_not_have(tmp_path: Path) -> None:
    config = load_probe_machine(probe_files.lay_out(tmp_path))
    with pytest.raises(InputError, match=r"lacks the table \[boss\]"):
        config.require_feature("boss")
