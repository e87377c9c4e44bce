"""What a drive says of its units against the axis file: agreement in every way it may be meant, and each mistake by its name."""

from __future__ import annotations

from fractions import Fraction

import pytest

from drivers.cia402.units import readings
from drivers.scaling import AxisScaling, ReportedScaling
from hil.doctor.drive_units import compare_units

F = Fraction
NOTHING = ReportedScaling()
ENCODER = F(131072)


def axis(counts: int = 131072, feed: float = 10.0, gear: str = "1") -> AxisScaling:
    return AxisScaling(counts, feed, F(gear))


@pytest.mark.parametrize(
    ("reported", "scaling", "end"),
    [
        (NOTHING, axis(), "only a move proves them"),
        (ReportedScaling(ENCODER, F(1), F(10)), axis(), "13107.2 counts/mm: as the axis file"),
        (ReportedScaling(ENCODER, F(5, 2), F(5)), axis(feed=5.0, gear="5/2"), "65536 counts/mm: as the axis file"),
        (ReportedScaling(ENCODER), axis(), "as far as it goes"),
        (ReportedScaling(None, F(3)), axis(gear="3"), "as far as it goes"),
        (ReportedScaling(None, None, F(10)), axis(), "as far as it goes"),
        # 60A8h in µm: the wire counts micrometres, whatever the encoder
        (ReportedScaling(ENCODER, F(1), F(10), F(10_000)), axis(10_000), "1000 counts/mm: as the axis file"),
        (ReportedScaling(ENCODER, F(4), F(10), F(10_000)), axis(2_500, gear="4"), "1000 counts/mm: as the axis file"),
        # a lead of 5.08 mm is 5.08, however it is stored
        (ReportedScaling(ENCODER, F(1), F(127, 25)), axis(feed=5.08), "as the axis file"),
    ],
)
def test_agreement(reported: ReportedScaling, scaling: AxisScaling, end: str) -> None:
    verdict = compare_units((reported,), scaling)
    assert verdict.agrees
    assert verdict.detail.endswith(end)


@pytest.mark.parametrize(
    ("reported", "scaling", "words"),
    [
        (
            ReportedScaling(ENCODER, F(1), F(10)),
            axis(32768),
            "encoder_counts_per_motor_rev is 32768 (0.25 of the drive's: lines instead of counts",
        ),
        (ReportedScaling(F(10000), F(1)), axis(40000), "4 times the drive's: quadrature counted twice"),
        (
            ReportedScaling(ENCODER, F(1), F(20)),
            axis(),
            "feed_mm_per_shaft_rev is 10 (0.5 of the drive's: a double-start",
        ),
        (ReportedScaling(ENCODER, F(1), F(10)), axis(feed=254.0), "25.4 times the drive's: inches taken for mm"),
        (ReportedScaling(ENCODER, F(1), F(10)), axis(feed=100.0), "10 times the drive's: a wrong power of ten"),
        (ReportedScaling(ENCODER, F(1), F(10)), axis(feed=0.01), "0.001 of the drive's: a wrong power of ten"),
        (ReportedScaling(ENCODER, F(3)), axis(), "motor_revs_per_shaft_rev is 1: the gear is left out"),
        (ReportedScaling(ENCODER, F(3)), axis(gear="1/3"), "is 1/3: the gear is the wrong way round"),
        (ReportedScaling(ENCODER, F(3)), axis(gear="7"), "motor_revs_per_shaft_rev is 7 (7/3 times the drive's)"),
        (
            ReportedScaling(ENCODER, F(1), F(10), F(10_000)),
            axis(),
            "counts the encoder's increments where this drive speaks position units:"
            " encoder_counts_per_motor_rev is 131072, expected 10000",
        ),
        (
            ReportedScaling(ENCODER, F(1), F(10), F(10_000)),
            axis(1_000),
            "the axis file counts 1000 per shaft revolution (0.1 of the drive's: a wrong power of ten)",
        ),
        (ReportedScaling(None, None, None, F(10_000)), axis(20_000), "counts 20000 per shaft revolution (2 times"),
        (ReportedScaling(None, F(2)), axis(), "the gear is left out"),
    ],
)
def test_a_mistake_is_named(reported: ReportedScaling, scaling: AxisScaling, words: str) -> None:
    verdict = compare_units((reported,), scaling)
    assert not verdict.agrees
    assert words in verdict.detail
    assert "\n" not in verdict.detail


def test_two_mistakes_are_both_named() -> None:
    detail = compare_units((ReportedScaling(ENCODER, F(3), F(10)),), axis(32768, feed=5.0)).detail
    for words in ("lines instead of counts", "gear is left out", "feed_mm_per_shaft_rev is 5"):
        assert words in detail


def test_a_split_between_encoder_and_gear_does_not_matter_as_long_as_the_wire_counts_the_same() -> None:
    assert compare_units((ReportedScaling(F(1000), F(4), F(10)),), axis(4000)).agrees


# -- how a CiA-402 drive may mean it -----------------------------------------------------------------------------------
def test_a_length_as_the_unit_leaves_nothing_open() -> None:
    said = ReportedScaling(ENCODER, F(1), F(10), F(10_000))
    assert readings(said) == (said,)


@pytest.mark.parametrize("feed_is_units", [True, False], ids=["increments", "no 60A8h"])
def test_a_feed_without_a_length_may_be_position_units_or_a_lead_in_micrometres(feed_is_units: bool) -> None:
    said = ReportedScaling(ENCODER, F(1), None, F(10_000)) if feed_is_units else ReportedScaling(ENCODER, F(1), F(10))
    both = readings(said)
    assert compare_units(both, axis()).agrees, "encoder increments on the wire, a lead of 10 mm"
    assert compare_units(both, axis(10_000, feed=4.0)).agrees, "10 000 position units per revolution, lead unknown"
    assert not compare_units(both, axis(feed=5.0)).agrees
    assert not compare_units(both, axis(20_000)).agrees


def test_a_feed_that_is_the_encoders_or_a_factory_value_says_nothing_of_the_lead() -> None:
    assert readings(ReportedScaling(ENCODER, F(1), None, ENCODER)) == (ReportedScaling(ENCODER, F(1), None, ENCODER),)
    for said in (ReportedScaling(ENCODER, F(1), None, F(1)), ReportedScaling(ENCODER, F(1), F(1, 1000))):
        assert readings(said) == (ReportedScaling(ENCODER, F(1)),)
    assert readings(NOTHING) == (NOTHING,)
    assert compare_units((), axis()).agrees
