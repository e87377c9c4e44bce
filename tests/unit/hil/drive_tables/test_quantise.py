"""The drive's table that comes closest to ours: over units, nodes, interpolation, directions and signs, judged by what the simulated
drive's own firmware makes of it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
import pytest

from drivers.correction_table import Directions, Interpolation, Nodes, Outside, Quantity, TableDescription
from drivers.drive import DriveLimits
from drivers.errors import InputError
from drivers.scaling import AxisScaling
from hil.compensation import Columns, Compensation
from hil.drive_tables import DriveTable, drive_table, largest_deviation_um, wanted_of
from hil.records import Floats
from hil.tables import DirectionalTable, SingleTable, TableMode, TableSet
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
COUNTS = Quantity("counts", 1.0, *I32)
TENTHS = Quantity("um", 0.05, *I16)
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
    Quantity("counts", 1.0, *U32),
    Quantity("um", 0.05, *I16),
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
        (Quantity("um", 1.0, *I32), Quantity("counts", 1.0, *I16)),
        (Quantity("mm", 0.1, *I32), Quantity("um", 0.1, *I16)),
        (Quantity("rev", 0.001, *I32), Quantity("rev", 1e-6, *I16)),
    ],
    ids=["um-counts", "mm-um", "rev-rev"],
)
def test_every_unit_comes_to_the_same(position: Quantity, value: Quantity) -> None:
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
    coarse = replace(PLAIN, value=Quantity("um", 0.4, *I16))
    found = drive_table(machine(), coarse, scaling(), LIMITS, deviation_um=0.5)
    assert 0.1 < found.rounding_um <= 0.2 + 1e-9
    assert found.rounding_um <= found.deviation_um <= 0.5
    assert found.largest_um == pytest.approx(53.8, abs=3.0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"value": Quantity("um", 2.0, *I16)}, "in steps of 2 µm, which alone may be 1 µm off; allow"),
        ({"points": 3}, "at most 3 fit"),
        ({"points": 4, "nodes": Nodes.EQUIDISTANT}, "no equal step with at most 4 points"),
        ({"points": 20, "interpolation": Interpolation.STEP}, "with the .* points that suit it best it is .* µm off"),
        (
            {"value": Quantity("um", 0.05, -128, 127)},
            r"a value is -\d+.* µm, and the drive holds -6.4 to 6.35 µm there; take",
        ),
        ({"position": Quantity("counts", 1.0, *I16)}, "a node stands .* µm, and the drive holds .*; shorten the axis"),
        ({"step": Quantity("counts", 1.0, 0, 100), "nodes": Nodes.EQUIDISTANT}, "the nodes stand apart"),
        (
            {"backlash": Quantity("um", 0.05, 0, 10), "directions": Directions.BACKLASH},
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
        straightness=SingleTable(np.array([0.0, 500.0]), np.array([1.0, 2.0])),
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
