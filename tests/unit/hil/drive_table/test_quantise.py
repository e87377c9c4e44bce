"""The drive's table that comes closest to ours: over units, nodes, interpolation, directions and signs, judged by what the simulated
drive's own firmware makes of it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers.correction_table import Directions, Interpolation, Nodes, Outside, RawFormat, TableDescription
from drivers.errors import CorrectionBoundError, InputError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from hil.correction.bound import CAREFUL, CorrectionBound
from hil.correction.compensation import Columns, Compensation
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.drive_table.curve import DriveCurve, check_curve, largest_deviation_um
from hil.drive_table.quantise import DriveTable, drive_table, wanted_of
from hil.records.rows import Floats
from sim_backends.own_table import OwnTable, TableForm

LIMITS = DriveLimits(-2.0, 502.0, 200.0, 2000.0)
COUNTS_PER_MM = 10_000


@dataclass(frozen=True)
class Lead:
    """A term that reads these columns."""

    needs: tuple[str, ...]

    def error_um(self, columns: Columns) -> Floats:
        return 0.01 * columns["target_mm"]


I16, I32, U32 = (-32768, 32767), (-(2**31), 2**31 - 1), (0, 2**32 - 1)
COUNTS = RawFormat("counts", 1.0, *I32)
TENTHS = RawFormat("um", 0.05, *I16)
PLAIN = TableDescription(
    "pitch table",
    300,
    Nodes.EXPLICIT,
    Interpolation.LINEAR,
    Outside.HOLD,
    Directions.BOTH,
    1,
    COUNTS,
    TENTHS,
    RawFormat("counts", 1.0, *U32),
    RawFormat("um", 0.05, *I16),
)


def scaling(direction: int = 1) -> AxisScaling:
    return AxisScaling(100_000, 10.0, direction=direction)


def machine(backlash_um: float = 12.0, waviness_um: float = 3.0) -> DirectionalTable:
    """A lead error with some waviness, and a backlash that is the same or nearly the same everywhere."""
    places = np.array([5.0, 31.3, 60.2, 100.0, 148.7, 200.1, 251.0, 299.9, 350.0, 410.4, 460.0, 495.0])
    plus = -0.08 * places + waviness_um * np.sin(places / 40.0)
    return DirectionalTable(places, plus, plus - backlash_um)


def firmware_um(found: DriveTable, description: TableDescription, direction: int, places: Floats, way: int) -> Floats:
    """What the simulated drive adds at places, at the load."""
    raw = found.raw
    per_um = COUNTS_PER_MM / 1000.0
    unit = {"counts": 1.0, "um": per_um, "mm": 1000.0 * per_um, "rev": 100_000.0}
    form = TableForm(
        points=description.points,
        explicit=description.nodes is Nodes.EXPLICIT,
        place_counts=description.position.scale * unit[description.position.unit],
        value_counts=description.value.scale * unit[description.value.unit],
        stepped=description.interpolation is Interpolation.STEP,
        zero_outside=description.outside is Outside.ZERO,
        curves=2 if description.directions is Directions.BOTH else 1,
        negated=description.sign < 0,
    )
    table = OwnTable(form, True, raw.nodes, raw.plus, raw.minus, raw.backlash)
    assert table.usable()
    upwards = way * direction > 0
    added = [table.added(direction * place * COUNTS_PER_MM, upwards) for place in places.tolist()]
    return direction * np.array(added) / per_um


FORMS = [
    replace(PLAIN, nodes=nodes, interpolation=interpolation, outside=outside, directions=directions, sign=sign)
    for nodes, interpolation, outside, directions, sign in itertools.product(
        Nodes, Interpolation, Outside, (Directions.BOTH, Directions.BACKLASH), (1, -1)
    )
    if (outside is Outside.ZERO) is (sign > 0)  # every pair of options all the same
]


@pytest.mark.parametrize("description", FORMS, ids=lambda each: f"{each.nodes.value}-{each.interpolation.value}")
@pytest.mark.parametrize("direction", [1, -1])
def test_the_drives_own_firmware_makes_our_correction_of_it(description: TableDescription, direction: int) -> None:
    wanted = machine()
    found = drive_table(wanted, description, scaling(direction), LIMITS, deviation_um=0.6)
    assert found.deviation_um <= 0.6
    assert found.rounding_um <= 0.025 + 1e-9
    places = np.concatenate([np.linspace(-1.9, 501.9, 23), wanted.position_mm])
    for way in (1, -1):
        there = firmware_um(found, description, direction, places, way)
        assert np.max(np.abs(there - wanted.at(places, way))) <= found.deviation_um + 0.002
        assert np.max(np.abs(there - found.curve.correction_um(places, way))) <= 0.002


@pytest.mark.parametrize(
    ("position", "value"),
    [
        (RawFormat("um", 1.0, *I32), RawFormat("counts", 1.0, *I16)),
        (RawFormat("mm", 0.1, *I32), RawFormat("um", 0.1, *I16)),
        (RawFormat("rev", 0.001, *I32), RawFormat("rev", 1e-6, *I16)),
    ],
    ids=["um-counts", "mm-um", "rev-rev"],
)
def test_every_unit_comes_to_the_same(position: RawFormat, value: RawFormat) -> None:
    wanted = machine()
    description = replace(PLAIN, position=position, value=value)
    found = drive_table(wanted, description, scaling(), LIMITS)
    places = np.array([7.7, 100.0, 333.3])
    for way in (1, -1):
        there = firmware_um(found, description, 1, places, way)
        assert np.max(np.abs(there - wanted.at(places, way))) <= found.deviation_um + 0.02


def test_equal_steps_are_as_few_as_do() -> None:
    places = np.linspace(0.0, 500.0, 26)
    straight = DirectionalTable(places, 0.1 * places, 0.1 * places - 5.0)
    description = replace(PLAIN, nodes=Nodes.EQUIDISTANT)
    assert len(drive_table(straight, description, scaling(), LIMITS).raw.plus) == 2
    assert 5 < len(drive_table(machine(), description, scaling(), LIMITS).raw.plus) < 100


def test_one_curve_is_enough_where_the_directions_agree() -> None:
    one = replace(PLAIN, directions=Directions.ONE)
    found = drive_table(machine(backlash_um=0.4), one, scaling(), LIMITS)
    assert found.deviation_um == pytest.approx(0.2, abs=0.06)
    with pytest.raises(InputError, match=r"one curve for both directions.*12.000 µm.*backlash parameter"):
        drive_table(machine(), one, scaling(), LIMITS)


def test_the_rounding_error_is_that_of_the_step() -> None:
    coarse = replace(PLAIN, value=RawFormat("um", 0.4, *I16))
    found = drive_table(machine(), coarse, scaling(), LIMITS, deviation_um=0.5)
    assert 0.1 < found.rounding_um <= 0.2 + 1e-9
    assert found.rounding_um <= found.deviation_um <= 0.5
    assert found.largest_um == pytest.approx(53.8, abs=3.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"value": RawFormat("um", 2.0, *I16)}, "in steps of 2 µm, which alone may be 1 µm off; allow"),
        ({"points": 3}, "at most 3 fit"),
        ({"points": 4, "nodes": Nodes.EQUIDISTANT}, "no equal step with at most 4 points"),
        ({"points": 20, "interpolation": Interpolation.STEP}, "with the .* points that suit it best it is .* µm off"),
        (
            {"value": RawFormat("um", 0.05, -128, 127)},
            r"a value is -\d+.* µm, and the drive holds -6.4 to 6.35 µm there; take",
        ),
        ({"position": RawFormat("counts", 1.0, *I16)}, "a node stands .* µm, and the drive holds .*; shorten the axis"),
        ({"step": RawFormat("counts", 1.0, 0, 100), "nodes": Nodes.EQUIDISTANT}, "the nodes stand apart"),
        (
            {"backlash": RawFormat("um", 0.05, 0, 10), "directions": Directions.BACKLASH},
            "the backlash is 12 µm, and the drive holds 0 to 0.5 µm there; scale the drive's table coarser",
        ),
    ],
)
def test_what_cannot_be_held_is_refused_with_what_to_change(change: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        drive_table(machine(), replace(PLAIN, **change), scaling(), LIMITS)  # type: ignore[arg-type]


def test_a_table_for_another_axis_is_refused() -> None:
    tables = TableSet(
        TableMode.BIDIRECTIONAL,
        machine(),
        straightness=DirectionalTable.alike(np.array([0.0, 500.0]), np.array([1.0, 2.0])),
        straightness_axis="Y",
    )
    with pytest.raises(InputError, match="corrects axis Y"):
        wanted_of(Compensation(tables))


def test_an_empty_table_adds_nothing() -> None:
    found = drive_table(machine(), PLAIN, scaling(), LIMITS)
    empty = replace(found.curve, raw=type(found.raw)())
    assert float(np.max(np.abs(empty.correction_um(np.linspace(0.0, 500.0, 7), 1)))) == 0.0
    assert largest_deviation_um(empty, machine(), -2.0, 502.0) == pytest.approx(found.largest_um)


def test_an_effect_that_no_table_holds_is_refused_or_left_out() -> None:
    tables = TableSet(TableMode.BIDIRECTIONAL, machine())
    assert float(wanted_of(Compensation(tables)).at(100.0, 1)) == pytest.approx(float(machine().at(100.0, 1)))
    warm = Compensation(tables, (Lead(("temp_screw_c",)),))
    with pytest.raises(InputError, match="holds Lead"):
        wanted_of(warm)
    left_out = wanted_of(warm, leave_out_effects=True)
    assert float(left_out.at(100.0, -1)) == pytest.approx(float(machine().at(100.0, -1)))


def test_what_a_drive_would_add_is_held_against_the_axis_bound() -> None:
    large = DirectionalTable(machine().position_mm, machine().plus_um + 600.0, machine().minus_um + 600.0)
    with pytest.raises(CorrectionBoundError, match="pitch table: what the drive would add by its table: "):
        drive_table(large, PLAIN, scaling(), LIMITS)
    made = drive_table(large, PLAIN, scaling(), LIMITS, bound=CorrectionBound(700.0))
    with pytest.raises(CorrectionBoundError):
        check_curve(made.curve, LIMITS, CAREFUL)
    ends = DriveCurve(replace(PLAIN, outside=Outside.ZERO), made.raw, scaling())
    with pytest.raises(CorrectionBoundError, match=r"changes by \d{3}\.?\d* µm between"):  # it ends inside the travel
        check_curve(ends, LIMITS, CorrectionBound(700.0))


RAMP = DirectionalTable(np.array([0.0, 100.0]), np.array([0.0, 10.0]), np.array([0.0, 10.0]))
"""A µm every 10 mm."""
SHORT = DriveLimits(0.0, 100.0, 200.0, 2000.0)
STAIRS = replace(PLAIN, nodes=Nodes.EQUIDISTANT, interpolation=Interpolation.STEP, value=TENTHS)


def level(plus_um: float, minus_um: float, *, to_plus_um: float | None = None) -> DirectionalTable:
    plus = np.array([plus_um, plus_um if to_plus_um is None else to_plus_um])
    return DirectionalTable(np.array([0.0, 100.0]), plus, np.full(2, minus_um))


def test_stairs_by_hand() -> None:
    """0.6 µm less half a value of 0.05: steps up to 11.5 mm are 0.575 µm off at either end; a ninth of 100 mm, rounded up, is 11.1112.

    Values in the middle of each: 0.55556 µm are 11 raw, 1.66668 33; the last node, 100.0008 mm, has the whole 10 µm.
    """
    found = drive_table(RAMP, replace(STAIRS, points=10), scaling(), SHORT, deviation_um=0.6)
    assert (found.raw.origin, found.raw.step, len(found.raw.plus)) == (0, 111_112, 10)
    assert found.raw.plus[:3] == (11, 33, 56)
    assert found.raw.plus[-2:] == (189, 200)
    assert found.raw.plus == found.raw.minus
    assert found.deviation_um == pytest.approx(0.575, abs=0.006)
    with pytest.raises(InputError, match=r"with the 9 points that suit it best it is 0.625 µm off"):
        drive_table(RAMP, replace(STAIRS, points=9), scaling(), SHORT, deviation_um=0.6)
    later = replace(RAMP, position_mm=RAMP.position_mm + 5.00005)
    limits = DriveLimits(5.00005, 105.00005, 200.0, 2000.0)
    assert (
        drive_table(later, STAIRS, scaling(), limits, deviation_um=0.6).raw.origin == 50_000
    )  # not after the first node
    even = replace(PLAIN, nodes=Nodes.EQUIDISTANT)
    assert drive_table(later, even, scaling(), limits).raw.origin == 50_000


def test_stairs_that_are_level_are_one_step() -> None:
    assert drive_table(level(1.0, 0.5), STAIRS, scaling(), SHORT).raw.plus == (20, 20)


def test_whole_steps_are_taken_as_they_are() -> None:
    """A first node at 5 mm is 50 000 counts; ten steps of 10 mm are 0.5 µm off, and 100 000 counts each."""
    five = replace(RAMP, position_mm=RAMP.position_mm + 5.0)
    limits = DriveLimits(5.0, 105.0, 200.0, 2000.0)
    assert drive_table(five, replace(PLAIN, nodes=Nodes.EQUIDISTANT), scaling(), limits).raw.origin == 50_000
    found = drive_table(five, replace(STAIRS, points=11), scaling(), limits, deviation_um=0.54)
    assert (found.raw.origin, found.raw.step, len(found.raw.plus)) == (50_000, 100_000, 11)


def test_one_curve_is_the_middle_of_both() -> None:
    one = replace(PLAIN, directions=Directions.ONE)
    found = drive_table(level(10.0, 9.4), one, scaling(), SHORT)
    assert (found.raw.plus, found.raw.minus, found.raw.backlash) == ((194, 194), (), 0)
    # half a µm is allowed where nothing else is said, and half a step of a value is taken off
    drive_table(level(0.94, 0.0), one, scaling(), SHORT)
    with pytest.raises(InputError, match=r"ours differ by up to 0.960 µm"):
        drive_table(level(0.96, 0.0), one, scaling(), SHORT)
    # 0.475 µm are 9.5 steps, which become 10: just the half µm that is allowed
    assert drive_table(level(0.95, 0.0), one, scaling(), SHORT).deviation_um == pytest.approx(0.5, abs=1e-9)
    with pytest.raises(InputError, match=r"ours differ by up to 1.200 µm"):
        drive_table(level(0.2, 0.0, to_plus_um=1.2), one, scaling(), SHORT)


def test_a_backlash_of_its_own_is_beside_the_curve() -> None:
    """10 and 8 µm: 2 µm less for falling counts, 40 steps."""
    beside = replace(PLAIN, directions=Directions.BACKLASH)
    found = drive_table(level(10.0, 8.0), beside, scaling(), SHORT)
    assert (found.raw.plus, found.raw.minus, found.raw.backlash) == ((200, 200), (), 40)
    subtracted = drive_table(level(10.0, 8.0), replace(beside, sign=-1), scaling(), SHORT)
    assert (subtracted.raw.plus, subtracted.raw.backlash) == ((-200, -200), -40)


def test_by_how_much_rounding_has_moved_values() -> None:
    """0.07 µm becomes 0.05, 0.11 becomes 0.10: 0.02 at most. A backlash of 0.5 in steps of 0.4 becomes 0.4: 0.1."""
    found = drive_table(level(0.07, 0.11), PLAIN, scaling(), SHORT)
    assert (found.raw.plus, found.raw.minus) == ((1, 1), (2, 2))
    assert (found.rounding_um, found.deviation_um) == pytest.approx((0.02, 0.02))
    coarse = replace(PLAIN, directions=Directions.BACKLASH, backlash=RawFormat("um", 0.4, *I16))
    found = drive_table(level(1.0, 0.5), coarse, scaling(), SHORT)
    assert found.raw.backlash == 1
    assert found.rounding_um == pytest.approx(0.1)


def test_values_that_may_be_as_far_off_as_is_allowed_are_refused() -> None:
    whole = replace(PLAIN, value=RawFormat("um", 1.0, *I16))
    with pytest.raises(InputError, match=r"in steps of 1 µm, which alone may be 0.5 µm off"):
        drive_table(level(1.0, 1.0), whole, scaling(), SHORT)
    assert drive_table(level(1.0, 1.0), whole, scaling(), SHORT, deviation_um=0.51).raw.plus == (1, 1)


def test_the_ends_of_what_it_holds_belong_to_it() -> None:
    narrow = replace(PLAIN, value=RawFormat("um", 0.05, -128, 127))
    found = drive_table(level(6.35, -6.4), narrow, scaling(), SHORT)
    assert (found.raw.plus, found.raw.minus) == ((127, 127), (-128, -128))


def test_a_drive_that_adds_nothing_outside_has_nodes_just_beyond_the_travel() -> None:
    """Travel -2 to 502 mm, a tenth of a µm further on either side."""
    found = drive_table(machine(), replace(PLAIN, outside=Outside.ZERO), scaling(), LIMITS)
    assert (found.raw.position[0], found.raw.position[-1]) == (-20_001, 5_020_001)


def test_what_one_curve_leaves_out_is_taken_from_what_thinning_may_leave_out() -> None:
    """Directions 0.6 µm apart cost 0.3 of the 0.475 µm: a bend of 0.25 µm stays, one of 0.17 µm goes."""
    places = np.array([0.0, 25.0, 50.0, 75.0, 100.0])
    middle, half = np.array([0.0, 0.25, 0.0, 0.1, 0.0]), np.array([0.3, 0.3, 0.3, 0.1, 0.1])
    one = replace(PLAIN, directions=Directions.ONE, points=4)
    found = drive_table(DirectionalTable(places, middle + half, middle - half), one, scaling(), SHORT)
    assert found.raw.nodes == (0, 250_000, 1_000_000)
    assert found.deviation_um == pytest.approx(0.3 + 0.5 / 3, abs=0.026)
