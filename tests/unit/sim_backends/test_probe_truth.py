"""The simulated probe against places worked out by hand."""

from __future__ import annotations

import math

import pytest

from sim_backends.plant.touch_probe import Bore, Chip, Face, Stylus
from sim_backends.probe import ProbeParameters, SimulatedProbe


def test_a_ball_touches_a_straight_face_one_radius_before_it() -> None:
    probe = SimulatedProbe(ProbeParameters(Stylus(2.0), (Face((105.0, 40.0, 0.0)),)))
    assert not probe.closed(102.9999, 40.0, 0.0)
    assert probe.closed(103.0, 40.0, 0.0)
    assert not probe.closed(103.5, 60.1, 0.0)  # past the block's side
    assert not probe.closed(140.0, 40.0, 0.0)  # behind the block


def test_a_face_met_the_other_way_round() -> None:
    probe = SimulatedProbe(ProbeParameters(Stylus(2.0), (Face((105.0, 40.0, 0.0), -1),)))
    assert not probe.closed(107.0001, 40.0, 0.0)
    assert probe.closed(107.0, 40.0, 0.0)


@pytest.mark.parametrize(("angle_deg", "contact_mm"), [(0, 102.99), (90, 102.98), (180, 103.01), (270, 103.02)])
def test_an_offset_turns_counter_clockwise_with_the_spindle(angle_deg: float, contact_mm: float) -> None:
    """Offset (0.010, −0.020): towards the face by 0.010, 0.020, −0.010, −0.020."""
    probe = SimulatedProbe(ProbeParameters(Stylus(2.0, (0.010, -0.020)), (Face((105.0, 40.0, 0.0)),)))
    assert probe.pushed_mm(contact_mm, 40.0, angle_deg) == pytest.approx(0.0, abs=1e-12)


def test_a_tilted_face_is_met_sooner_on_one_side() -> None:
    """Tilted by 3-4-5 about z: the normal is (−0.8, 0.6); 5 mm further along y the face is 3.75 mm further away."""
    face = Face((105.0, 40.0, 0.0), tilt_z_rad=math.atan2(3.0, 4.0))
    assert face.clearance_mm((100.0, 40.0, 0.0)) == pytest.approx(4.0)
    assert face.clearance_mm((100.0 + 3.75, 45.0, 0.0)) == pytest.approx(4.0)
    leaning = Face((105.0, 40.0, 0.0), tilt_y_rad=math.atan2(3.0, 4.0))
    assert leaning.clearance_mm((100.0, 40.0, 5.0)) == pytest.approx(4.0 + 3.0)


def test_a_bore_is_round_and_may_lean() -> None:
    assert Bore((50.0, 60.0, 0.0), 10.0).clearance_mm((53.0, 64.0, 9.0)) == pytest.approx(5.0)
    assert Bore((50.0, 60.0, 0.0), 10.0, (0.6, 0.0, 0.8)).clearance_mm((53.0, 60.0, 4.0)) == pytest.approx(10.0)
    assert math.isinf(Bore((50.0, 60.0, 0.0), 10.0, wall_mm=5.0).clearance_mm((66.0, 60.0, 0.0)))


def test_the_signal_comes_after_the_pretravel_and_sooner_by_a_chip() -> None:
    stylus = Stylus(2.0, pretravel_mm=0.01)
    probe = SimulatedProbe(ProbeParameters(stylus, (Face((105.0, 40.0, 0.0)),), (Chip(0.05, 1, 1),)))
    contacts = []
    for _ in range(3):
        x_mm = 102.0
        while not probe.follow(x_mm, 40.0, 0.0):
            x_mm += 0.001
        contacts.append(round(x_mm, 6))
        probe.follow(102.0, 40.0, 0.0)
    assert contacts == pytest.approx([103.01, 102.96, 103.01], abs=1.01e-3)
    assert probe.touches == 3


def test_a_loose_tool_moves_with_the_spindle_only() -> None:
    face = Face((105.0, 40.0, 0.0))
    probe = SimulatedProbe(ProbeParameters(Stylus(2.0), (face,), play_mm=0.02))
    seen = []
    for angle_deg in (0.0, 0.0, 90.0, 90.0, 180.0):
        probe.follow(102.0, 40.0, angle_deg)
        seen.append(probe.pushed_mm(103.0, 40.0, angle_deg))
    assert seen[0] == seen[1] != seen[2] == seen[3] != seen[4]
    assert max(map(abs, seen)) <= 0.02
