"""What a drive says of its units, read from the simulated one."""

from fractions import Fraction

import pytest

from drivers.canopen.bus import CanLink
from drivers.canopen.sdo import SdoClient
from drivers.canopen.units import read_units
from drivers.scaling import ReportedScaling
from sim_backends.canopen_bench import CanBench

NODE = 5
INCREMENTS, MICROMETRES, MILLIMETRES, TENTHS_OF_MICROMETRES = 0x00B50000, 0xFA010000, 0xFD010000, 0xF9010000


def _read(objects: dict[tuple[int, int], int], *, without: tuple[int, ...] = ()) -> ReportedScaling:
    bench = CanBench((NODE,), parameters=objects)
    items = bench.slave.dictionary.items
    for key in [key for key in items if key[0] in without]:
        del items[key]
    with CanLink(bench.port(), bench.clock) as link:
        return read_units(SdoClient(link, NODE, "drive X"))


ENCODER = {(0x608F, 1): 100_000, (0x608F, 2): 1}
GEAR = {(0x6091, 1): 5, (0x6091, 2): 2}


def test_positions_in_increments() -> None:
    """100 000 increments per motor revolution, gear 5:2: 250 000 of them per shaft revolution; no word of millimetres."""
    said = _read({**ENCODER, **GEAR, (0x6092, 1): 250_000, (0x60A8, 0): INCREMENTS})
    assert said == ReportedScaling(Fraction(100_000), Fraction(5, 2), None, Fraction(250_000))
    assert said.counts_per_load_mm is None


@pytest.mark.parametrize(
    ("si_unit", "feed", "counts_per_mm"),
    [(MICROMETRES, 10_000, 1_000), (MILLIMETRES, 10, 1), (TENTHS_OF_MICROMETRES, 100_000, 10_000)],
)
def test_positions_as_lengths_tell_the_lead(si_unit: int, feed: int, counts_per_mm: int) -> None:
    said = _read({**ENCODER, (0x6092, 1): feed, (0x60A8, 0): si_unit})
    assert said.feed_mm_per_shaft_rev == 10
    assert said.position_units_per_shaft_rev == feed
    assert said.counts_per_load_mm == counts_per_mm


def test_a_feed_over_several_revolutions() -> None:
    said = _read({(0x6092, 1): 25_400, (0x6092, 2): 5, (0x60A8, 0): MICROMETRES})
    assert said.feed_mm_per_shaft_rev == Fraction(508, 100)


def test_without_a_unit_the_feed_is_taken_in_micrometres() -> None:
    said = _read({**ENCODER, **GEAR, (0x6092, 1): 5_000}, without=(0x60A8,))
    assert said == ReportedScaling(Fraction(100_000), Fraction(5, 2), Fraction(5), None)
    assert said.counts_per_load_mm == 50_000


def test_what_a_drive_does_not_have_is_unknown() -> None:
    said = _read({}, without=(0x608F, 0x6091, 0x6092))
    assert said == ReportedScaling(None, None, None, None)
