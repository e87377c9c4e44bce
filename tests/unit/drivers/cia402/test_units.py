"""What a drive says of its units, read from the simulated one."""

from fractions import Fraction
from functools import partial

import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.node import Node
from drivers.canopen.raw_parameters import CanOpenRawParameters
from drivers.canopen.sdo import SdoClient
from drivers.canopen.side_by_side import CanLine
from drivers.cia402.objects import Entry
from drivers.cia402.units import motion_units, read_units
from drivers.errors import AbortError, BridgeError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling, MotionScaling, ReportedScaling

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


def test_positions_in_degrees_or_turns_of_the_shaft() -> None:
    """0.1 degrees (FF41 0000h, as one maker delivers it): 3600 position units per revolution."""
    assert _read({**ENCODER, (0x60A8, 0): 0xFF410000}).position_units_per_shaft_rev == 3600
    assert _read({**ENCODER, (0x60A8, 0): 0xFDB40000}).position_units_per_shaft_rev == 1000


# -- units of velocity and acceleration --------------------------------------------------------------------------------------
AXIS = AxisScaling(4096, 10.0)  # 10 mm/s is one turn per second
Objects = dict[tuple[int, int], int]


class _Drive(SdoClient):
    """A drive that holds these objects and no others."""

    def __init__(self, objects: Objects) -> None:
        self._objects = objects

    def read(self, entry: Entry) -> int:
        if (entry.index, entry.subindex) not in self._objects:
            raise AbortError(f"{entry} refused: object does not exist", 0x06020000)
        return self._objects[entry.index, entry.subindex]


def _units(objects: Objects, vendor: int = 0, **stated: str) -> MotionScaling:
    return motion_units(partial(_Drive(objects).read_if_shown, absent=None), AXIS, vendor=vendor, **stated)  # type: ignore[arg-type]


def _asked(units: MotionScaling) -> tuple[int, int]:
    """What 10 mm/s and 100 mm/s² are in the drive's units."""
    assert not units.ambiguous
    return units.velocity_units(10.0), units.acceleration_units(100.0)


@pytest.mark.parametrize(
    ("objects", "velocity", "acceleration"),
    [
        ({}, 4096, 40_960),
        ({(0x60A9, 0): 0, (0x60AA, 0): 0}, 4096, 40_960),
        ({(0x60A9, 0): 0x00B44700}, 60, 600),  # rpm; the ramp per second, as no object states it
        ({(0x60A9, 0): 0x00B44700, (0x60AA, 0): 0x00C00300}, 60, 600),  # EPOS4 as delivered
        ({(0x60A9, 0): 0xFDB44700, (0x60AA, 0): 0x00C00300}, 60_000, 600),  # milli-rpm
        ({(0x60A9, 0): 0x00B40300, (0x60AA, 0): 0x00B40303}, 1, 10),  # turns/s and turns/s/s
        ({(0x60A9, 0): 0x00B50300, (0x60AA, 0): 0x00B55700}, 4096, 40_960),  # increments
        ({(0x60A9, 0): 0xFF410300}, 3600, 36_000),  # 0.1 degrees/s
        ({(0x60A9, 0): 0xFD010300, (0x60AA, 0): 0xFD015700}, 10, 100),  # mm/s, mm/s²
        ({(0x608B, 0): 0, (0x608C, 0): 0xA4, (0x608D, 0): 0, (0x608E, 0): 0xA4}, 60, 600),  # EPOS2's
        ({(0x608B, 0): -1, (0x608C, 0): 0xA4}, 600, 6000),  # deci-rpm
        ({(0x608B, 0): 0, (0x608C, 0): 0xA3}, 1, 10),
        ({(0x608B, 0): 0, (0x608C, 0): 0}, 4096, 40_960),
        ({(0x6094, 1): 4096, (0x6094, 2): 60}, 60, 600),  # increments/s in one unit: rpm by a factor
        ({(0x6096, 1): 4096, (0x6096, 2): 1}, 1, 10),
        ({(0x6094, 1): 1, (0x6094, 2): 1}, 4096, 40_960),
        ({(0x6094, 1): 4096, (0x6094, 2): 60, (0x6097, 1): 4096, (0x6097, 2): 1}, 60, 10),
        ({(0x60A9, 0): 0x00B44700, (0x6094, 1): 4096, (0x6094, 2): 60}, 60, 600),  # both say rpm
        ({(0x6090, 1): 4096, (0x6090, 2): 1, (0x608F, 1): 4096, (0x608F, 2): 1}, 4096, 40_960),
    ],
)
def test_units_that_the_objects_state(objects: Objects, velocity: int, acceleration: int) -> None:
    assert _asked(_units(objects)) == (velocity, acceleration)


@pytest.mark.parametrize(
    ("vendor", "velocity", "acceleration"),
    [(0xFB, 60, 600), (0x147, 60, 10), (0x26C, 60, 600), (0x2BE, 60, 600), (0x9A, 4096, 40_960)],
)
def test_units_by_the_makers_manual(vendor: int, velocity: int, acceleration: int) -> None:
    assert _asked(_units({}, vendor)) == (velocity, acceleration)
    assert _asked(_units({(0x60A9, 0): 0x00B40300, (0x60AA, 0): 0x00B40303}, vendor)) == (1, 10)


def test_the_axis_file_states_what_no_object_does() -> None:
    assert _asked(_units({}, velocity="rpm")) == (60, 600)
    assert _asked(_units({}, velocity="rpm", acceleration="rev/s2")) == (60, 10)
    assert _asked(_units({}, 0x1A3, velocity="1/65536 counts/ms")) == (268_435, 2684)
    assert _asked(_units({(0x60A9, 0): 0x00B44700}, velocity="rev/min")) == (60, 600)


@pytest.mark.parametrize(
    ("objects", "vendor", "stated", "words"),
    [
        ({(0x60A9, 0): 0x00B44700}, 0, {"velocity": "counts/s"}, "the axis file says counts/s, 60A9h says rev/min"),
        ({(0x60A9, 0): 0x00B44700, (0x608C, 0): 0xA3}, 0, {}, "60A9h says rev/min, 608Bh and 608Ch says rev/s"),
        ({(0x60A9, 0): 0x00990300}, 0, {}, "60A9h is 00990300h, which is no unit"),
        ({(0x608C, 0): 0x77}, 0, {}, "608Ch is 77h"),
        ({(0x6090, 1): 2000, (0x6090, 2): 1, (0x608F, 1): 4096, (0x608F, 2): 1}, 0, {}, "6090h has 2000 increments"),
        ({}, 0x286, {}, "Trinamic's modules take turns per minute"),
        ({}, 0x1A3, {}, "Technosoft's drives"),
        ({(0x60A9, 0): 0x00B44700, (0x60AA, 0): 0x00990300}, 0, {}, "unit of acceleration is not known"),
    ],
)
def test_ambiguous_units_are_told_with_the_remedy(
    objects: Objects, vendor: int, stated: dict[str, str], words: str
) -> None:
    units = _units(objects, vendor, **stated)
    assert words in units.ambiguous
    assert "_unit in [drive]" in units.ambiguous


# -- the same units beside the drive's parameters ------------------------------------------------------------------------------
LIMITS = DriveLimits(-200.0, 200.0, 200.0, 2000.0)


@pytest.mark.parametrize(
    ("vendor", "stated", "speed", "ramp"),
    [
        (0, {}, "counts/s", "counts/s2"),
        (0xFB, {}, "rpm", "rpm/s"),  # maxon, by its manual
        (0xFB, {"acceleration_unit": "rev/s2"}, "rpm", "rev/s2"),
        (0, {"velocity_unit": "0.1 rpm"}, "0.1 rpm", "0.1 rpm/s"),
        (0x286, {}, "", ""),  # Trinamic: by model, so that nothing is known
    ],
)
def test_speeds_and_ramps_among_the_parameters_are_in_the_drives_own_units(
    vendor: int, stated: dict[str, str], speed: str, ramp: str
) -> None:
    bench = CanBench((NODE,), parameters={(0x1018, 1): vendor})
    with CanLink(bench.port(), bench.clock) as link:
        line = CanLine(link)
        node = Node("X", link, NODE)
        node.open()
        raw = CanOpenRawParameters(node, line, scaling=AXIS, **stated)  # type: ignore[arg-type]
        (identity,) = line.run([raw.identify()])
        assert not isinstance(identity, BridgeError)
        found = {
            address: raw.unit_of(raw.entries[address]) for address in ("6099h:01", "6085h:00", "607Ch:00", "6098h:00")
        }
        assert found == {"6099h:01": speed, "6085h:00": ramp, "607Ch:00": "counts", "6098h:00": ""}
        node.close()
        settings = CanOpenSettings(**stated)  # type: ignore[arg-type]
        with CanOpenDrive("X", AXIS, LIMITS, bench.clock, link=link, node_id=NODE, settings=settings) as drive:
            names = ("homing_speed_during_search_for_switch", "quick_stop_deceleration", "home_offset")
            assert [drive.parameters.describe(name).unit for name in names] == [speed, ramp, "counts"]


def test_without_the_axis_files_scaling_no_unit_of_speed_is_claimed() -> None:
    bench = CanBench((NODE,))
    with CanLink(bench.port(), bench.clock) as link:
        line = CanLine(link)
        node = Node("X", link, NODE)
        node.open()
        raw = CanOpenRawParameters(node, line)
        line.run([raw.identify()])
        assert [raw.unit_of(raw.entries[address]) for address in ("6099h:01", "6085h:00")] == ["", ""]
        node.close()
