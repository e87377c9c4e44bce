"""Set-up of the instrument: the beam's angle from two places, lengths at 20 °C, and how both stand in the axis file and the rows."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from support.bench_axis import lay_out
from support.toy_axis import ToyMachine, toy_session

from drivers.errors import InputError, MeasurementLostError
from drivers.instrument import Environment
from hil.axis.axis_file import load_axis
from hil.axis.identity import instrument_identity
from hil.doctor.command import beam_check
from hil.figures.alignment import Alignment
from hil.figures.material import Material
from hil.figures.uncertainty import UncertaintyInputs

SECTIONS = """place_temps = { screw = 4 }
air_equation = "ciddor"

[instrument.alignment]
near_mm = 0.0
far_mm = 500.0
height_mm = [0.0, 0.8]
side_mm = [0.2, -0.4]

[instrument.material]
expansion_ppm_per_k = 11.7
place = "screw"
"""


def test_an_angle_from_two_heights() -> None:
    """0.8 mm up and 0.6 mm aside over 500 mm: 1 mm, 2 mrad, 2 ppm short."""
    beam = Alignment(0.0, 500.0, (0.0, 0.8), (0.2, -0.4), read_within_mm=0.1)
    assert beam.angle_mrad == pytest.approx(2.0)
    assert beam.short_ppm == pytest.approx(2.0)
    assert 500.0 * (1.0 - math.cos(2e-3)) / 500.0 * 1e6 == pytest.approx(beam.short_ppm, rel=1e-5)
    assert Alignment(0.0, 500.0, (0.0, 0.8), (0.2, -0.4), returning=True).short_ppm == pytest.approx(0.5)


def test_the_worst_that_two_readings_of_each_spot_allow() -> None:
    beam = Alignment(500.0, 0.0, (0.0, 0.0), (0.0, 0.0), read_within_mm=0.5)
    worst = math.hypot(1.0, 1.0) / 500.0
    assert (beam.short_ppm, beam.short_at_most_ppm) == (0.0, pytest.approx(worst**2 / 2 * 1e6))
    assert beam.lateral_mm(500.0) == pytest.approx(math.hypot(1.0, 1.0))


def test_both_worst_cases_add_up() -> None:
    """Seen 1 mm over 500 mm, 2 mrad; each spot within 0.5 mm: √2·2·0.5 / 500 = 2.828 mrad more; (4.828)² / 2 = 11.657 ppm.

    Near 500 and far 0, or both on either side of zero, are the same 500 mm.
    """
    for near_mm, far_mm in ((0.0, 500.0), (500.0, 0.0), (-200.0, 300.0)):
        beam = Alignment(near_mm, far_mm, (0.0, 0.8), (0.2, -0.4), read_within_mm=0.5)
        assert beam.angle_mrad == pytest.approx(2.0)
        assert beam.readable_mrad == pytest.approx(2.8284271)
        assert beam.short_at_most_ppm == pytest.approx(11.656854)
        assert beam.lateral_mm(1000.0) == pytest.approx(4.8284271)  # 4.828 mrad over a metre
        assert beam.good
    returned = Alignment(0.0, 500.0, (0.0, 0.8), (0.2, -0.4), read_within_mm=0.5, returning=True)
    assert (returned.angle_mrad, returned.readable_mrad) == pytest.approx((1.0, 1.4142136))
    assert not Alignment(0.0, 500.0, (0.0, 0.8), (0.2, -0.4), read_within_mm=0.3).good  # 1.697 mrad would be seen
    assert Alignment(0.0, 500.0, (0.0, 1.0), (0.0, 0.0)).read_within_mm == 0.5
    assert Alignment(-5.0, 5.0, (0.0, 0.0), (0.0, 0.0)).angle_mrad == 0.0  # just far enough apart
    with pytest.raises(InputError, match="10 mm apart"):
        Alignment(100.0, 109.9, (0.0, 0.0), (0.0, 0.0))


@pytest.mark.parametrize(("height_mm", "good"), [(1.4, True), (1.5, False)])
def test_a_beam_that_could_be_seen_to_be_off_is_not_good(height_mm: float, good: bool) -> None:
    """Each spot within 0.5 mm in two directions: 1.414 mm apart they may stand without being told apart."""
    check = beam_check(Alignment(0.0, 500.0, (0.0, height_mm), (0.0, 0.0)))
    assert check.good is good
    assert ("can be aligned better" in check.detail) is not good
    assert f"reads {(height_mm / 500 * 1000) ** 2 / 2:.2f} ppm short" in check.detail


@pytest.mark.parametrize(
    ("far_mm", "within_mm", "says"), [(5.0, 0.5, "10 mm apart"), (500.0, 0.0, "read_within_mm is 0")]
)
def test_an_alignment_that_says_nothing_is_refused(far_mm: float, within_mm: float, says: str) -> None:
    with pytest.raises(InputError, match=says):
        Alignment(0.0, far_mm, (0.0, 0.0), (0.0, 0.0), within_mm)


def test_steel_of_a_metre_at_25_degrees_is_58_um_shorter_at_20() -> None:
    steel = Material(11.7, "screw")
    warm = Environment(0, air_temp_c=22.0, place_temps_c={"screw": 25.0})
    assert (1000.0 - steel.at_reference_mm(1000.0, warm)) * 1000 == pytest.approx(58.5, abs=0.01)
    assert steel.at_reference_mm(-1000.0, warm) == -steel.at_reference_mm(1000.0, warm)
    assert (1000.0 - Material(11.7, "air").at_reference_mm(1000.0, warm)) * 1000 == pytest.approx(23.4, abs=0.01)
    with pytest.raises(MeasurementLostError, match="no temperature of nut"):
        Material(11.7, "nut").at_reference_mm(1.0, warm)


@pytest.mark.parametrize("reference_mm", [0.0, 30.0])
def test_rows_are_lengths_from_the_reference_at_20_degrees(reference_mm: float) -> None:
    machine = ToyMachine(play_mm=0.0, wave_um=0.0, temperatures={"screw": 30.0})
    with toy_session(machine, reference_mm=reference_mm) as session:
        session.material = Material(10.0, "screw")
        session.prepare()
        session.move_to(100.0)
        got_um = (session.read_position().position_load_mm - 100.0) * 1000.0
    assert got_um == pytest.approx(-(100.0 - reference_mm) * 0.1, abs=1e-3)


def test_the_set_up_is_read_recorded_and_shown(tmp_path: Path) -> None:
    path = lay_out(tmp_path)
    path.write_text(
        path.read_text().replace("place_temps = { screw = 4 }", SECTIONS) + "\n[uncertainty]\nvariation_um = 1.5\n"
    )
    axis = load_axis(path)
    assert axis.instrument.material == Material(11.7, "screw")
    assert axis.uncertainty == UncertaintyInputs(variation_um=1.5)
    recorded = axis.purpose("calibrate")["instrument"]
    assert recorded["alignment"]["height_mm"] == (0.0, 0.8)
    assert recorded["material"]["expansion_ppm_per_k"] == 11.7
    assert recorded["air_equation"] == "ciddor"
    shown = instrument_identity(axis.instrument)
    assert shown["Air compensation"] == "Ciddor"
    assert shown["Beam against motion"].startswith("2.00 mrad, reads 2.00 ppm short (at most ")
    assert "11.7 ppm/K" in shown["Lengths at 20 °C"]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('place = "screw"', 'place = "nut"', "temperature of nut"),
        ("side_mm = [0.2, -0.4]", "side_mm = [0.2]", "side_mm is"),
        ('"ciddor"', '"owens"', "expected edlen or ciddor"),
        ("far_mm = 500.0", "far_mm = 1.0", "10 mm apart"),
        ("[instrument.material]", "[uncertainty]\nvariation_um = -1\n[instrument.material]", "variation_um is -1"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = lay_out(tmp_path)
    path.write_text(path.read_text().replace("place_temps = { screw = 4 }", SECTIONS.replace(old, new)))
    with pytest.raises(InputError, match=says):
        load_axis(path)
