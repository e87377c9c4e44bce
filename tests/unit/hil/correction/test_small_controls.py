"""Small controls: what is written is read back, what stays is told by the true figure, and what they cannot take is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from hil.correction.formats import grbl, mach
from hil.correction.formats.common import both_directions
from hil.correction.tables import DirectionalTable, TableMode, TableSet

AT = np.array([0.0, 100.0, 200.0, 300.0])


def tables(plus_um: list[float], minus_um: list[float], at: np.ndarray = AT) -> TableSet:
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(at, np.array(plus_um), np.array(minus_um)))


def test_grblhal_by_hand() -> None:
    """A backlash of 12 µm and 30 µm/m: $160 takes the first, 800 steps/mm times 1.00003 the second, nothing is left."""
    made = grbl.export_grblhal(tables([0, 3, 6, 9], [-12, -9, -6, -3]), grbl.GrblHalSettings("Y", 800.0))
    assert made.text.splitlines()[1:] == ["$161=0.012", "$101=800.02400"]
    assert made.deviation_um == pytest.approx(0.0, abs=0.01)
    assert made.shift_um == pytest.approx(0.0, abs=0.01)


def test_what_a_backlash_and_a_line_cannot_take_is_refused_or_told() -> None:
    """A triangle of 8 µm: the best line is level at half of it."""
    triangle = tables([0, 8, 0, 8], [-10, -2, -10, -2])
    with pytest.raises(InputError, match=r"up to 4\.000 µm from the tables, more than 0\.1 µm"):
        grbl.export_grblhal(triangle)
    made = grbl.export_grblhal(triangle, grbl.GrblHalSettings(tolerance_um=4.5))
    assert made.deviation_um == pytest.approx(4.0)
    assert made.text.splitlines()[1:] == ["$160=0.010"]
    with pytest.raises(InputError, match="state those that are set now"):
        grbl.export_fluidnc(triangle)
    with pytest.raises(InputError, match=r"up to 9\."):  # the backlash stays too: 4 + 5
        grbl.export_fluidnc(triangle, grbl.FluidNcSettings(steps_per_mm=800.0, tolerance_um=8.0))
    with pytest.raises(InputError, match="cannot be negative"):
        grbl.export_grblhal(tables([0, 0, 0, 0], [9, 9, 9, 9]))


def test_a_line_is_never_worse_than_none() -> None:
    rng = np.random.default_rng(4)
    for _ in range(30):
        curve = rng.normal(0.0, 5.0, 4)
        one = tables(list(curve), list(curve - 6.0))
        without = grbl.export_grblhal(one, grbl.GrblHalSettings(tolerance_um=99.0)).deviation_um
        assert grbl.export_grblhal(one, grbl.GrblHalSettings("X", 800.0, 99.0)).deviation_um <= without + 1e-3


@given(
    curve=st.lists(st.floats(-30, 30), min_size=5, max_size=12),
    lost=st.floats(0, 20),
    wave=st.floats(0, 3),
    asymmetric=st.booleans(),
    mach3=st.booleans(),
)
@settings(max_examples=60)
def test_a_screw_map_is_read_back_within_what_it_says(
    curve: list[float], lost: float, wave: float, asymmetric: bool, mach3: bool
) -> None:
    at = np.linspace(-40.0, 260.0, len(curve))
    both = tables(curve, [y - lost - wave * (k % 2) for k, y in enumerate(curve)], at)
    chosen = mach.Mach3Settings(tolerance_um=2.0) if mach3 else mach.Mach4Settings(asymmetric, tolerance_um=2.0)
    made = mach.export(both, chosen)
    back, wanted = both_directions(mach.load(made.text, chosen)), both_directions(both)
    where = np.linspace(-40.0, 260.0, 2001)
    off = max(float(np.max(np.abs(back.at(where, sign) - wanted.at(where, sign)))) for sign in (1, -1))
    assert off <= made.deviation_um + 1e-6
    assert made.deviation_um <= 4.0 + 0.2  # half of what the ways differ by, and the resampling
    assert "# backlash" in made.text or (asymmetric and not mach3)


def test_screw_maps_by_hand() -> None:
    """Correction +2 µm at 100 mm in +, -10 µm of backlash: Mach4 wants expected - actual, Mach3 where the axis really is."""
    two = tables([0, 2, 4], [-10, -8, -6], np.array([0.0, 100.0, 200.0]))
    assert mach.export(two, mach.Mach4Settings(step_mm=100.0)).text.splitlines()[1:] == [
        "position_mm,error_positive_mm,error_negative_mm",
        "0.0000,0.0000,-0.0100",
        "100.0000,0.0020,-0.0080",
        "200.0000,0.0040,-0.0060",
    ]
    assert mach.export(two, mach.Mach3Settings(step_mm=100.0)).text.splitlines()[1:] == [
        "# backlash 0.0100 mm",
        "commanded_mm,real_mm",
        "0.0000,0.0000",
        "100.0000,99.9980",
        "200.0000,199.9960",
    ]
    with pytest.raises(InputError, match="one map for both ways"):
        mach.Mach3Settings(asymmetric=True)
    with pytest.raises(InputError, match="the two directions differ by"):
        mach.export(tables([0, 2, 4], [-10, -2, -6], np.array([0.0, 100.0, 200.0])), mach.Mach3Settings())


@pytest.mark.parametrize("delimiter", [";", ",", "\t"])
def test_a_screw_map_is_read_as_a_spreadsheet_saves_it(delimiter: str) -> None:
    """The backlash stands in a remark: it must not get lost on the way."""
    rows = ["# start 0 mm", "# backlash 0.0030 mm", "position_mm,error_mm", "0,0", "100,0.002"]
    saved = "\n".join(["sep=" + delimiter, *(f"{row},".replace(",", delimiter) for row in rows), delimiter * 2])
    assert mach.load(saved).digest() == mach.load("\n".join(rows)).digest()
    assert mach.load(saved).correction_um(0.0, -1) == pytest.approx(-3.0)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,2,3\n4,5,6\n", "is no header of a screw map"),
        ("position_mm,error_mm\n0,0\n", "at least two points"),
        ("position_mm,error_mm\n0,0\n0,1\n", "do not ascend"),
        ("position_mm,error_mm\n0,0,1\n", "3 columns"),
        ("position_mm,error_mm\n0,x\n", "value is 'x'"),
        ("# backlash 0,01 mm\nposition_mm,error_mm\n0,0\n9,0\n", "the backlash is '0,01'"),
        ("# backlash: 0.01\nposition_mm,error_mm\n0,0\n9,0\n", "expected such as"),
    ],
)
def test_a_torn_screw_map_is_refused(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        mach.load(text)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("$160=0.01\n", "from where to where"),
        ("; hil: X from 0 to 9 mm\nG0 X1\n", "expected a setting"),
        ("; hil: Y from 0 to 9 mm\n", "is of axis Y"),
        ("; hil: X from 0 to 9 mm\n$100=801\n", "state those of before"),
    ],
)
def test_torn_settings_are_refused(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        grbl.load_grblhal(text)
