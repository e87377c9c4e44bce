"""Controller tables: random round trips through each format, the worked example of each manual, and what is refused."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.errors import InputError
from hil.correction.formats import CONTROLLERS, Controller, fanuc, linuxcnc, sinumerik, twincat
from hil.correction.formats.common import Export, both_directions, equidistant
from hil.correction.formats.fanuc import FanucSettings
from hil.correction.formats.linuxcnc import LinuxCncSettings
from hil.correction.formats.sinumerik import SinumerikSettings
from hil.correction.formats.twincat import TwinCatSettings
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet

Floats = NDArray[np.float64]
LENIENT = {"grblhal": {"tolerance_um": 99.0}, "fluidnc": {"tolerance_um": 99.0, "steps_per_mm": 800.0}}
"""Settings with which controls that hold no table write what they can hold."""
MANY = settings(max_examples=50, suppress_health_check=[HealthCheck.too_slow], derandomize=True)


def _curve(rng: np.random.Generator, positions: Floats, size_um: float) -> Floats:
    """A smooth part, a cyclic part and noise."""
    u = (positions - positions[0]) / (positions[-1] - positions[0])
    smooth = size_um * (rng.uniform(-1, 1) * u + rng.uniform(-1, 1) * u**2)
    cyclic = size_um * 0.1 * np.sin(2 * np.pi * rng.uniform(1, 5) * u + rng.uniform(0, 6))
    return np.asarray(smooth + cyclic + rng.normal(0, size_um * 0.02, len(positions)))


def build(seed: int, *, equidistant: bool, constant_backlash: bool) -> TableSet:
    """2 to 40 sections of 5 to 100 mm, up to some ten µm, in either mode, with any of the parts a set can have."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(2, 41))
    step = round(float(rng.uniform(5, 100)), 2)
    positions = round(float(rng.uniform(-2000, 500)), 3) + step * np.arange(count)
    if not equidistant:
        positions = np.round(positions + rng.uniform(-0.3, 0.3, count) * step, 3)
    plus = _curve(rng, positions, float(rng.uniform(2, 30)))
    backlash = np.full(count, rng.uniform(-3, 12))
    if not constant_backlash:
        backlash = backlash + _curve(rng, positions, 3.0)
    specified = DirectionalTable.constant(positions, float(rng.uniform(-8, 8))) if rng.uniform() < 0.3 else None
    straightness = None
    if rng.uniform() < 0.3:
        one, other = (_curve(rng, positions, 4.0) for _ in range(2))
        straightness = DirectionalTable(positions, one, one if constant_backlash else other)
    if rng.uniform() < 0.5:
        pitch = DirectionalTable(positions, plus, plus)
        return TableSet(
            TableMode.UNIDIRECTIONAL_BACKLASH, pitch, SingleTable(positions, backlash), specified, straightness
        )
    pitch = DirectionalTable(positions, plus, plus - backlash)
    return TableSet(TableMode.BIDIRECTIONAL, pitch, None, specified, straightness)


def table_sets(*, equidistant: bool = False, constant_backlash: bool = False) -> st.SearchStrategy[TableSet]:
    return st.integers(0, 2**32 - 1).map(
        lambda seed: build(seed, equidistant=equidistant, constant_backlash=constant_backlash)
    )


def worst_um(tables: TableSet, controller: TableSet, shift_um: float = 0.0) -> float:
    """Largest difference of two corrections (the first less a shift), both ways, over a grid that reaches beyond both ends."""
    nodes = tables.pitch.position_mm
    grid = np.union1d(np.linspace(nodes[0] - 30, nodes[-1] + 30, 3001), nodes)
    return max(
        float(np.max(np.abs(tables.correction_um(grid, sign) - shift_um - controller.correction_um(grid, sign))))
        for sign in (1, -1)
    )


def fanuc_export(tables: TableSet, chosen: FanucSettings) -> tuple[Export, FanucSettings]:
    """With the magnification doubled until a point holds the steepest section."""
    while True:
        try:
            return fanuc.export(tables, chosen), chosen
        except InputError as error:
            if "magnification" not in error.what:
                raise
            chosen = replace(chosen, magnification=2 * chosen.magnification)


@pytest.fixture
def small() -> TableSet:
    """At 10, 20 and 30 mm the correction is 0, +5, -2 µm upwards, and 4 µm less downwards."""
    plus = np.array([0.0, 5.0, -2.0])
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(np.array([10.0, 20.0, 30.0]), plus, plus - 4.0))


# -- LinuxCNC ----------------------------------------------------------------------------------------------------------


@MANY
@given(table_sets(), st.sampled_from([0, 1]), st.sampled_from(["mm", "inch"]))
def test_linuxcnc_round_trip(tables: TableSet, comp_type: int, unit: str) -> None:
    chosen = LinuxCncSettings(comp_type, unit)
    made = linuxcnc.export(tables, chosen)
    assert worst_um(tables, linuxcnc.load(made.text, chosen)) <= 3e-5  # nine decimals of a mm or an inch
    assert made.deviation_um <= 3e-5
    assert made.points <= 256


def test_linuxcnc_signs_and_layout(small: TableSet) -> None:
    """Trims are added to the command; type 0 gives the position that is reached, nominal + error = nominal - correction."""
    trims = linuxcnc.export(small, LinuxCncSettings(comp_type=1)).text
    assert trims.splitlines()[1] == "20.000000000 0.005000000 0.001000000"
    reached = linuxcnc.export(small, LinuxCncSettings(comp_type=0)).text
    assert reached.splitlines()[1] == "20.000000000 19.995000000 19.999000000"
    inches = linuxcnc.export(small, LinuxCncSettings(comp_type=1, unit="inch")).text
    assert inches.splitlines()[1].split()[0] == "0.787401575"
    assert all(len(line.split()) == 3 for line in trims.splitlines())
    assert not any(mark in trims for mark in "#;(")


def test_linuxcnc_thins_what_has_too_many_points() -> None:
    positions = np.arange(600.0)
    straight = np.interp(positions, [0, 300, 599], [0.0, 12.0, -7.0])
    rough = straight + 0.05 * (-1.0) ** np.arange(600)
    tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(positions, straight, straight - 3))
    made = linuxcnc.export(tables)
    assert made.points == 3
    assert worst_um(tables, linuxcnc.load(made.text)) < 1e-4
    rough_tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(positions, rough, rough))
    with pytest.raises(InputError, match=r"600 points, and at most 256 fit; with that many it deviates by 0\.0"):
        linuxcnc.export(rough_tables, LinuxCncSettings(tolerance_um=0.01))
    for amplitude in (0.0502, 0.0506):  # the tolerance that is advised is accepted, however its last digit was rounded
        uneven = straight + amplitude * (-1.0) ** np.arange(600)
        advised_tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(positions, uneven, uneven))
        with pytest.raises(InputError, match="allow that") as refused:
            linuxcnc.export(advised_tables, LinuxCncSettings(tolerance_um=0.01))
        advised = float(str(refused.value).split("deviates by ")[1].split()[0])
        linuxcnc.export(advised_tables, LinuxCncSettings(tolerance_um=advised))
    allowed = linuxcnc.export(rough_tables, LinuxCncSettings(tolerance_um=0.11))
    assert 0.0 < allowed.deviation_um <= 0.1101
    assert worst_um(rough_tables, linuxcnc.load(allowed.text)) == pytest.approx(allowed.deviation_um, abs=1e-4)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("# a comment\n1 0 0\n", r"no triplet"),
        ("1 0 0\n2 0\n", "no triplet"),
        ("1 0 0\n\n2 0 0\n", "after the empty line 2"),
        ("1 0 0\n1 0 0\n", "does not ascend"),
        ("1 0 x\n", "expected a number"),
        ("", "holds no triplet"),
        ("".join(f"{n} 0 0\n" for n in range(257)), "at most 256"),
    ],
)
def test_linuxcnc_refuses_what_the_control_would_not_read(text: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        linuxcnc.load(text)


# -- SINUMERIK ---------------------------------------------------------------------------------------------------------

K3_EXAMPLE = """\
%_N_AX_EEC_INI
CHANDATA(1)
$AA_ENC_COMP[0,0,X1]=0.003 ; first point
$AA_ENC_COMP[0,1,X1]=0.01
$AA_ENC_COMP[0,2,X1]=0.012
$AA_ENC_COMP[0,3,X1]=-0.0
$AA_ENC_COMP_STEP[0,X1]=1.0
$AA_ENC_COMP_MIN[0,X1]=-200.0
$AA_ENC_COMP_MAX[0,X1]=-197.0
$AA_ENC_COMP_IS_MODULO[0,X1]=0
M17
"""


def test_sinumerik_a_positive_value_moves_the_axis_down() -> None:
    """The first points of the example of K3 (6FC5397-1BP40, 4.4.2.3): +3, +10, +12 µm from -200 mm in steps of 1 mm."""
    tables = sinumerik.load(K3_EXAMPLE)
    assert tables.correction_um([-200.0, -199.0, -198.0, -197.0], 1) == pytest.approx([-3, -10, -12, 0])
    assert tables.correction_um(-199.5, -1) == pytest.approx(-6.5)
    assert tables.correction_um([-300.0, 0.0], 1) == pytest.approx([-3, 0])
    again = sinumerik.export(tables, SinumerikSettings(table="eec", reference_mm=0.0)).text
    values = [line for line in again.splitlines() if line.startswith("$")]
    assert values[:4] == [
        "$AA_ENC_COMP[0,0,X1]=0.003000",
        "$AA_ENC_COMP[0,1,X1]=0.010000",
        "$AA_ENC_COMP[0,2,X1]=0.012000",
        "$AA_ENC_COMP[0,3,X1]=0.000000",
    ]


@MANY
@given(table_sets(), st.sampled_from([1, -1]), st.floats(-2500, 3000))
def test_sinumerik_cec_round_trip(tables: TableSet, direction: int, reference_mm: float) -> None:
    chosen = SinumerikSettings(
        reference_mm=reference_mm, reference_direction=direction, allow_shift=True, max_points=2000, tolerance_um=0.3
    )
    made = sinumerik.export(tables, chosen)
    again = sinumerik.load(made.text)
    assert made.shift_um == pytest.approx(float(tables.correction_um(reference_mm, direction)))
    assert worst_um(tables, again, made.shift_um) <= made.deviation_um + 1e-9 <= 0.3021
    assert abs(float(again.correction_um(reference_mm, direction))) <= made.deviation_um + 1e-9


@MANY
@given(table_sets(equidistant=True, constant_backlash=True), st.sampled_from([1, -1]))
def test_sinumerik_eec_round_trip(tables: TableSet, towards: int) -> None:
    reference_mm = float(tables.pitch.position_mm[0])
    chosen = SinumerikSettings(table="eec", allow_shift=True, tolerance_um=0.05)
    made = sinumerik.export(tables, replace(chosen, reference_direction=towards, reference_mm=reference_mm))
    (first,) = re.findall(r"\$AA_ENC_COMP\[0,0,X1\]=(\S+)", made.text)
    assert abs(float(first)) <= 0.06e-3  # zero at the reference point, mm
    again = sinumerik.load(made.text)
    assert again.backlash is not None
    assert worst_um(tables, again, made.shift_um) <= made.deviation_um + 1e-9
    if made.points == len(tables.pitch.position_mm):
        assert made.deviation_um <= 0.0011


def test_sinumerik_two_tables_by_direction(small: TableSet) -> None:
    text = sinumerik.export(small, SinumerikSettings(axis="AX3", index=4, reference_mm=10.0)).text
    assert "$AN_CEC[4,1]=-0.005000" in text
    assert "$AN_CEC[5,1]=-0.001000" in text
    assert "$AN_CEC_DIRECTION[4]=1" in text
    assert "$AN_CEC_DIRECTION[5]=-1" in text
    assert "$AN_CEC_INPUT_AXIS[5]=(AX3)" in text
    assert text.startswith("%_N_NC_CEC_INI\nCHANDATA(1)\n")
    assert text.endswith("M17\n")


def test_sinumerik_backlash_is_md32450(small: TableSet) -> None:
    made = sinumerik.export(small, SinumerikSettings(table="eec", reference_mm=10.0))
    assert ";$MA_BACKLASH[0,X1]=0.004000" in made.text
    assert any("MD32450" in note and "0.004000" in note for note in made.notes)
    assert "$AA_ENC_COMP[0,2,X1]=0.002000" in made.text


def test_sinumerik_table_is_that_of_the_reference_direction(small: TableSet) -> None:
    """Approached downwards, the control is zero there downwards, and puts the backlash in on its way up."""
    made = sinumerik.export(
        small, SinumerikSettings(table="eec", reference_mm=10.0, reference_direction=-1, allow_shift=True)
    )
    assert made.shift_um == -4.0
    values = re.findall(r"\$AA_ENC_COMP\[0,\d,X1\]=(\S+)", made.text)
    assert values == ["0.000000", "-0.005000", "0.002000"]
    again = sinumerik.load(made.text)
    assert again.correction_um([10.0, 20.0, 30.0], -1) == pytest.approx([0.0, 5.0, -2.0])
    assert again.correction_um([10.0, 20.0, 30.0], 1) == pytest.approx([4.0, 9.0, 2.0])


def test_sinumerik_wants_zero_at_the_reference(small: TableSet) -> None:
    with pytest.raises(InputError, match=r"reference point 20 mm is 5\.000 µm .* allow the shift"):
        sinumerik.export(small, SinumerikSettings(reference_mm=20.0))
    made = sinumerik.export(small, SinumerikSettings(reference_mm=20.0, allow_shift=True))
    assert made.shift_um == 5.0
    assert "$AN_CEC[0,1]=0.000000" in made.text


def test_sinumerik_cross_axis_goes_into_a_third_table(small: TableSet) -> None:
    at, plus_um = np.array([10.0, 30.0]), np.array([0.0, 6.0])
    tables = replace(small, straightness=DirectionalTable.alike(at, plus_um), straightness_axis="Y1")
    text = sinumerik.export(tables, SinumerikSettings(reference_mm=10.0)).text
    assert "$AN_CEC_OUTPUT_AXIS[2]=(Y1)" in text
    again = sinumerik.load(text)
    assert again.straightness_axis == "Y1"
    assert again.cross_correction_um([20.0, 20.0], [1, -1], "Y1") == pytest.approx(3.0)
    by_direction = replace(tables, straightness=DirectionalTable(at, plus_um, plus_um / 2.0))
    each = sinumerik.export(by_direction, SinumerikSettings(reference_mm=10.0)).text
    assert [f"$AN_CEC_DIRECTION[{index}]={sign}" in each for index, sign in ((2, 1), (3, -1))] == [True, True]
    assert sinumerik.load(each).cross_correction_um([20.0, 20.0], [1, -1], "Y1") == pytest.approx([3.0, 1.5])
    with pytest.raises(InputError, match=r"second one for direction \+1"):
        sinumerik.load(each.replace("[3]=(Y1)", "[3]=(X1)").replace("DIRECTION[3]=-1", "DIRECTION[3]=0"))
    assert worst_um(tables, again) < 0.001
    for controller in CONTROLLERS:
        more = {"table": "eec"} if controller.name == "sinumerik" else LENIENT.get(controller.name, {})
        chosen = controller.settings(**more)
        with pytest.raises(InputError, match="corrects axis Y1"):
            controller.export(tables, chosen)


def test_sinumerik_says_what_to_change() -> None:
    positions = np.array([0.0, 10.0, 21.3])
    tables = TableSet(
        TableMode.BIDIRECTIONAL,
        DirectionalTable(positions, np.array([0.0, 9.0, 1.0]), np.array([-3.0, 2.0, -8.0])),
    )
    with pytest.raises(
        InputError, match=r"differ by 3\.000 to 9\.000 µm .* allow a deviation \(tolerance_um\) of 1\.500"
    ):
        sinumerik.export(tables, SinumerikSettings(table="eec"))
    with pytest.raises(InputError, match=r"with a step of 7 mm the table deviates by"):
        sinumerik.export(tables, SinumerikSettings(step_mm=7.0))
    with pytest.raises(InputError, match=r"no equal step with at most 3 points .* the best"):
        sinumerik.export(tables, SinumerikSettings(max_points=3))
    with pytest.raises(InputError, match=r"a step of 0\.1 mm needs 214 points, and at most 200 fit"):
        sinumerik.export(tables, SinumerikSettings(step_mm=0.1))
    large = TableSet(TableMode.BIDIRECTIONAL, tables.pitch.scaled(200))
    with pytest.raises(InputError, match="MD32720"):
        sinumerik.export(large, SinumerikSettings(tolerance_um=20))
    made = sinumerik.export(tables, SinumerikSettings(table="eec", tolerance_um=1.5, allow_shift=True))
    assert worst_um(tables, sinumerik.load(made.text), made.shift_um) <= 3.01


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("$AA_ENC_COMP[0,1,X1]=0.01\n", ""), "make points 0 to 3, the table holds 3"),
        (("=0.01\n", "=0.01\n$AA_ENC_COMP[0,1,X1]=0.02\n"), "a second time"),
        (("MODULO[0,X1]=0", "MODULO[0,X1]=1"), "modulo axis"),
        (("M17", "G1 X10"), "no line of a compensation table"),
        (("STEP[0,X1]=1.0", "STEP[0,X1]=0"), "make no grid"),
        (("0.012", "twelve"), "expected a number"),
        (("$AA_ENC_COMP_STEP[0,X1]=1.0\n", ""), "lacks STEP"),
    ],
)
def test_sinumerik_refuses_broken_files(change: tuple[str, str], complaint: str) -> None:
    assert change[0] in K3_EXAMPLE
    with pytest.raises(InputError, match=complaint):
        sinumerik.load(K3_EXAMPLE.replace(*change))


# -- FANUC -------------------------------------------------------------------------------------------------------------

B63980_NUMBERS = range(33, 50)
B63980_VALUES = (2, 1, 1, -2, 0, -1, 0, -1, 2, 1, 0, -1, -1, -2, 0, 1, 2)
"""The example of B-63980EN: reference at number 40, points every 50 mm from -400 mm (33 lies between -400 and -350)."""


def fanuc_example() -> str:
    head = (
        "%\nO1\nG10 L50\nN3605 P1 R00000000\nN3620 P1 R40\nN3621 P1 R33\nN3622 P1 R49\nN3623 P1 R1\nN3624 P1 R50000\n"
    )
    points = "".join(f"N{10000 + n} R{v}\n" for n, v in zip(B63980_NUMBERS, B63980_VALUES, strict=True))
    return head + points + "G11\nM30\n%\n"


def test_fanuc_sums_of_the_manuals_example() -> None:
    """The absolute curve: zero at the reference, each section's value between its two ends, added going up."""
    tables = fanuc.load(fanuc_example())
    assert tables.pitch.position_mm == pytest.approx(np.arange(-400.0, 451.0, 50.0))
    at = {float(p): float(c) for p, c in zip(tables.pitch.position_mm, tables.pitch.plus_um, strict=True)}
    assert (at[0.0], at[50.0], at[100.0], at[-50.0], at[-100.0]) == (0.0, 2.0, 3.0, 1.0, 1.0)
    assert (at[-250.0], at[-400.0], at[300.0], at[450.0]) == (4.0, 0.0, -1.0, 2.0)
    chosen = FanucSettings(bidirectional=False, step_mm=50.0, first_number=33)
    again = fanuc.export(tables, chosen).text
    for number, value in zip(B63980_NUMBERS, B63980_VALUES, strict=True):
        assert f"N{10000 + number} R{value}\n" in again
    assert {"N3620 P1 R40", "N3621 P1 R33", "N3622 P1 R49"} <= set(again.splitlines())


@MANY
@given(
    table_sets(),
    st.sampled_from([1, -1]),
    st.sampled_from([(1.0, 1), (0.1, 5), (1.0, 2)]),
    st.floats(-0.3, 1.3),
)
def test_fanuc_round_trip(tables: TableSet, towards: int, unit: tuple[float, int], where: float) -> None:
    nodes = tables.pitch.position_mm
    chosen = FanucSettings(
        axis=2,
        detection_unit_um=unit[0],
        magnification=unit[1],
        reference_mm=round(float(nodes[0] + where * (nodes[-1] - nodes[0])), 3),
        reference_direction=towards,
        allow_shift=True,
        tolerance_um=0.4,
    )
    made, chosen = fanuc_export(tables, chosen)
    again = fanuc.load(made.text, chosen)
    half_step = chosen.step_um / 2 + 0.4 + 1e-6
    assert worst_um(tables, again, made.shift_um) <= half_step
    at_reference = float(tables.correction_um(chosen.reference_mm, -towards)) - made.shift_um
    found = float(again.correction_um(chosen.reference_mm, -towards))
    assert abs(found - at_reference) <= chosen.detection_unit_um / 2 + 0.4 + 1e-6


@MANY
@given(table_sets(), st.floats(0.3, 3.0))
def test_a_step_is_refused_by_the_largest_difference_at_any_position(tables: TableSet, share: float) -> None:
    """Judged on a fine grid, and on the nodes of both: the refusal's boundary is the largest difference itself."""
    wanted = both_directions(tables)
    step_mm = round(share * float(np.median(np.diff(wanted.position_mm))), 2) + 0.01

    def resampled(tolerance_um: float) -> DirectionalTable:
        grid, _ = equidistant(wanted, step_mm, resolution_mm=0.01, max_points=10_000, tolerance_um=tolerance_um)
        return grid

    grid = resampled(np.inf)
    where = np.union1d(np.linspace(wanted.position_mm[0] - 9, grid.position_mm[-1] + 9, 4001), wanted.position_mm)
    where = np.union1d(where, grid.position_mm)
    worst = max(float(np.max(np.abs(wanted.at(where, sign) - grid.at(where, sign)))) for sign in (1, -1))
    assert resampled(worst + 1e-9) == grid
    with pytest.raises(InputError, match="deviates"):
        resampled(worst - 1e-9)


@MANY
@given(table_sets(equidistant=True, constant_backlash=True), st.sampled_from([1, -1]))
def test_fanuc_one_directional_round_trip(tables: TableSet, towards: int) -> None:
    chosen = FanucSettings(
        bidirectional=False,
        detection_unit_um=0.1,
        magnification=4,
        reference_mm=float(tables.pitch.position_mm[0]),
        reference_direction=towards,
        allow_shift=True,
        tolerance_um=0.4,
    )
    made, chosen = fanuc_export(tables, chosen)
    assert worst_um(tables, fanuc.load(made.text, chosen), made.shift_um) <= 0.4 + chosen.step_um / 2 + 0.05 + 1e-6


def test_fanuc_both_directions(small: TableSet) -> None:
    """Return to the reference at 10 mm upwards: 3627 is the downward correction there; both sets are increments upwards."""
    made = fanuc.export(small, FanucSettings(axis=3, reference_mm=10.0, first_number=20, step_mm=10.0, bits_3605=0b10))
    assert made.text.splitlines()[3:] == [
        "N3605 P3 R00000011",
        "N3620 P3 R19",
        "N3621 P3 R20",
        "N3622 P3 R21",
        "N3623 P3 R1",
        "N3624 P3 R10000",
        "N3626 P3 R22",
        "N3627 P3 R-4",
        "N10020 R5",
        "N10021 R-7",
        "N10022 R5",
        "N10023 R-7",
        "G11",
        "M30",
        "%",
    ]
    assert made.deviation_um < 1e-9
    down = fanuc.export(small, FanucSettings(reference_mm=10.0, reference_direction=-1, allow_shift=True, step_mm=10.0))
    assert "N3627 P1 R4" in down.text
    assert down.shift_um == -4.0


def test_fanuc_says_what_to_change(small: TableSet) -> None:
    chosen = FanucSettings(reference_mm=10.0, step_mm=10.0)
    steep = TableSet(TableMode.BIDIRECTIONAL, small.pitch.scaled(4.0))
    with pytest.raises(
        InputError, match=r"needs 28 steps of 1 µm, expected at most 7: set a magnification \(3623\) of 4"
    ):
        fanuc.export(steep, chosen)
    assert fanuc.export(steep, replace(chosen, magnification=4)).deviation_um < 1e-9
    with pytest.raises(InputError, match=r"reference point 20 mm is 5\.000 µm"):
        fanuc.export(small, replace(chosen, reference_mm=20.0))
    with pytest.raises(InputError, match=r"less than the 16\.000 mm"):
        fanuc.export(small, replace(chosen, rapid_mm_min=120_000))
    with pytest.raises(InputError, match=r"needs \d+ points, and at most"):
        fanuc.export(small, replace(chosen, step_mm=0.02))
    with pytest.raises(InputError, match=r"the step is 0\.0015 mm, expected a multiple of 0\.001 mm"):
        fanuc.export(small, replace(chosen, step_mm=0.0015))
    uneven = TableSet(
        TableMode.BIDIRECTIONAL,
        DirectionalTable(small.pitch.position_mm, small.pitch.plus_um, small.pitch.plus_um - [4.0, 6.0, 4.0]),
    )
    with pytest.raises(InputError, match="export both directions"):
        fanuc.export(uneven, replace(chosen, bidirectional=False))


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (("N10041 R2\n", ""), r"lacks point 41 \(N10041\)"),
        (("N10041 R2\n", "N10041 R9\n"), "expected -7 to 7"),
        (("N10041 R2\n", "N10041 R2\nN10041 R2\n"), "given twice"),
        (("N3624 P1 R50000\n", ""), "lacks parameter 3624"),
        (("N3620 P1 R40", "N3620 R40"), "lacks its axis"),
        (("N3620 P1 R40", "N3620 P1 R60"), "expected 3621 - 1 <= 3620 <= 3622"),
        (("G11\n", ""), r"no block of parameter input|from G10 L50 to G11"),
        (("G11\n", "G1 X1\nG11\n"), "no block of parameter input"),
    ],
)
def test_fanuc_refuses_broken_files(change: tuple[str, str], complaint: str) -> None:
    assert change[0] in fanuc_example()
    with pytest.raises(InputError, match=complaint):
        fanuc.load(fanuc_example().replace(*change))


# -- TwinCAT -----------------------------------------------------------------------------------------------------------


@MANY
@given(table_sets())
def test_twincat_round_trip(tables: TableSet) -> None:
    made = twincat.export(tables)
    assert worst_um(tables, twincat.load(made.text)) <= made.deviation_um + 1e-9 <= 0.0501 + 0.01


def test_twincat_values_are_errors() -> None:
    """The manual's example: commanded 19866.7 µm, reached 19856.5 going up and 19874.7 going down, gives -102 and 80."""
    error_um = {1: 19856.5 - 19866.7, -1: 19874.7 - 19866.7}
    positions = np.array([0.0, 19.8667])
    tables = TableSet(
        TableMode.BIDIRECTIONAL,
        DirectionalTable(positions, np.array([0.0, -error_um[1]]), np.array([0.0, -error_um[-1]])),
    )
    entries = dict(line.split() for line in twincat.export(tables, TwinCatSettings(2, "Y-AXIS")).text.splitlines())
    assert entries["kw.ssfk.table[1].setpoint"] == "198667"
    assert entries["kw.ssfk.table[1].pos"] == "-102"
    assert entries["kw.ssfk.table[1].neg"] == "80"
    assert (entries["kopf.achs_nr"], entries["kopf.log_achs_name"]) == ("2", "Y-AXIS")
    assert (entries["kw.ssfk.interval"], entries["kw.ssfk.unit"], entries["kw.ssfk.bilateral"]) == ("0", "1", "1")
    assert entries["kw.ssfk.kw_nr_max"] == "2"


def test_twincat_reads_equidistant_and_unilateral_lists() -> None:
    text = "kopf.achs_nr 1\nkw.ssfk.interval 100000 # 10 mm\nkw.ssfk.kw_startpos -50000\nkw.ssfk.kw_nr_max 2\n"
    text += "kw.ssfk.unit 1\nkw.ssfk.bilateral 0\nkw.ssfk.table[0].pos 10\nkw.ssfk.table[1].pos -25\n"
    tables = twincat.load(text)
    assert tables.correction_um([-5.0, 5.0], -1) == pytest.approx([-1.0, 2.5])
    for change, complaint in (
        (("unit 1", "unit 0"), "encoder increments"),
        (("table[1]", "table[7]"), r"lacks table\[1\]\.pos|the table holds"),
        (("kw_nr_max 2", "kw_nr_max 1"), "lies beyond kw_nr_max"),
        (("kw.ssfk.unit 1", "kw.crosscomp.unit 1"), "no leadscrew error compensation"),
        (("kopf.achs_nr 1", "hello"), "no entry"),
        (("-25", "x"), "expected a number"),
    ):
        with pytest.raises(InputError, match=complaint):
            twincat.load(text.replace(*change))


def test_twincat_thins_beyond_its_points(small: TableSet) -> None:
    with pytest.raises(InputError, match="3 points, and at most 2 fit"):
        twincat.export(small, TwinCatSettings(max_points=2))


# -- all ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make",
    [
        lambda: LinuxCncSettings(comp_type=2),
        lambda: LinuxCncSettings(unit="m"),
        lambda: SinumerikSettings(table="abc"),
        lambda: SinumerikSettings(axis="X 1"),
        lambda: FanucSettings(magnification=0),
        lambda: FanucSettings(reference_direction=0),
        lambda: TwinCatSettings(name=""),
    ],
)
def test_settings_are_checked(make: Callable[[], object]) -> None:
    with pytest.raises(InputError, match="expected"):
        make()


def test_a_single_position() -> None:
    """A constant per direction: LinuxCNC and TwinCAT hold it, a grid of equal steps does not."""
    tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(np.array([5.0]), np.array([0.0]), np.array([-1.0])))
    assert worst_um(tables, linuxcnc.load(linuxcnc.export(tables).text)) < 1e-5
    assert worst_um(tables, twincat.load(twincat.export(tables).text)) < 1e-5
    with pytest.raises(InputError, match="needs at least two"):
        sinumerik.export(tables)
    with pytest.raises(InputError, match="needs at least two"):
        fanuc.export(tables, FanucSettings(reference_mm=5.0))
    assert fanuc.load(fanuc.export(tables).text).correction_um(5.0, -1) == -1.0


SMALL = TableSet(
    TableMode.BIDIRECTIONAL,
    DirectionalTable(np.array([0.0, 10.0, 20.0]), np.array([0.0, 5.0, -2.0]), np.array([-4.0, 1.0, -6.0])),
)


@settings(max_examples=150, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(CONTROLLERS), st.data())
def test_a_damaged_file_gives_tables_or_one_kind_of_error(controller: Controller, data: st.DataObject) -> None:
    """Lines lost, doubled, swapped, characters changed: never an exception of another kind, never a run-away."""
    chosen = controller.settings(**LENIENT.get(controller.name, {}))
    lines = controller.export(SMALL, chosen).text.splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(lines) - 1))
        match data.draw(st.sampled_from(["drop", "double", "swap", "change", "number"])):
            case "drop" if len(lines) > 1:
                del lines[place]
            case "double":
                lines.insert(place, lines[place])
            case "swap":
                lines[place], lines[-1] = lines[-1], lines[place]
            case "number":
                huge = data.draw(st.sampled_from(["9" * 8, "9" * 400, "-1", "1e300", "nan", "0", "0.001"]))
                lines[place] = re.sub(r"[-+]?[\d.]+$", huge, lines[place])
            case _:
                text, at = lines[place], data.draw(st.integers(0, len(lines[place])))
                lines[place] = text[:at] + data.draw(st.text(max_size=2)) + text[at + 1 :]
    try:
        tables = controller.load("\n".join(lines), chosen)
    except InputError:
        return
    assert np.all(np.isfinite(tables.correction_um([-5.0, 5.0, 25.0], 1)))


ACHSKW = """\
# compensation of X
kw.ssfk.interval   20000{}
kw.ssfk.kw_startpos   -20000
kw.ssfk.kw_nr_max 3
kw.ssfk.unit 1
kw.ssfk.bilateral 0
kw.ssfk.table[0].pos 0{}
kw.ssfk.table[1].pos 90{}
kw.ssfk.table[2].pos 70
"""


@pytest.mark.parametrize(
    "comment",
    [
        "/* 0:Increments 1:Metric */",
        "(* -2.0 *)",
        "# /* open",
        "/* over\r\n * two lines # (* */",
        "(* without end",
        "// -2.0",
        "/**/ /* a */",
    ],
)
def test_twincat_comments_are_left_out_wherever_they_stand(comment: str) -> None:
    found = both_directions(twincat.load(ACHSKW.format(f"  {comment}", f"\t{comment}", comment)))
    assert found.position_mm.tolist() == [-2.0, 0.0, 2.0]
    assert found.plus_um == pytest.approx([0.0, -9.0, -7.0])
    with pytest.raises(InputError, match="'x'") as caught:
        twincat.load(ACHSKW.format("", comment, "") + "x")
    assert caught.value.line == len((ACHSKW.format("", comment, "") + "x").splitlines())


@pytest.mark.parametrize("comment", ["/* a /* b */ c\n*/", "(* (* b *)\n *)"])
def test_a_twincat_comment_within_a_comment_is_refused_as_that(comment: str) -> None:
    with pytest.raises(InputError, match=r"a comment within a comment ends both|'0 +c'"):
        twincat.load(ACHSKW.format("", f" {comment}", ""))


def test_a_twincat_comment_without_end_is_refused_with_its_line() -> None:
    with pytest.raises(InputError, match="does not end") as caught:
        twincat.load(ACHSKW.format(" /* a */", " /* a", ""))
    assert caught.value.line == 7


CEC = """\
%_N_NC_CEC_INI
CHANDATA(1)
$AN_CEC[0,0]=0
$AN_CEC[0,1]=0.002
$AN_CEC[0,2]=0.004
$AN_CEC_INPUT_AXIS[0]=(X1)
$AN_CEC_OUTPUT_AXIS[0]=(X1)
$AN_CEC_STEP[0]=100
$AN_CEC_MIN[0]=0
$AN_CEC_MAX[0]=200
$AN_CEC_DIRECTION[0]=0
"""


@pytest.mark.parametrize(
    "more",
    [
        "$AN_CEC_INPUT_NCU[0]=1\n$AN_CEC_OUTPUT_NCU[0]=1\nM17",
        "$an_cec_input_ncu[0] = 0\n$AN_CEC_OUTPUT_NCU[0]=0\nM0\nM17",
        "$AN_CEC_INPUT_NCU[0]=2\nM00",
        "N100 $AN_CEC_OUTPUT_NCU[0]=2\nN110 $SN_CEC_TABLE_ENABLE[0]=1\nN120 NEWCONF\nN130 M2",
        "RET",
        "N10$AN_CEC_IS_MODULO[0]=FALSE $AN_CEC_MULT_BY_TABLE[0]=0\nN20 STOPRE\nN30M17",
        "$MN_MM_CEC_MAX_POINTS[0]=6\n$MA_CEC_SCALING_SYSTEM_METRIC[AX1] = 1\n$AN_CEC[0,3]=0\n$AN_CEC[0,4]=0.0\nM17",
    ],
)
def test_sinumerik_lines_that_change_nothing(more: str) -> None:
    found = both_directions(sinumerik.read(CEC + more))
    assert found.plus_um == pytest.approx([0.0, -2.0, -4.0])
    assert found.minus_um == pytest.approx([0.0, -2.0, -4.0])


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ("$MA_CEC_SCALING_SYSTEM_METRIC[AX1]=0", "the tables are in inch"),
        ("$AN_CEC[0,3]=0\n$AN_CEC[0,4]=0.001", "make points 0 to 2, the table holds 5"),
        ("$AN_CEC_IS_MODULO[0]=-1", "of a modulo axis .IS_MODULO -1."),
        ("$AN_CEC[0,3]=0,002", "value is '0,002', expected a number$"),
        ("DEF REAL X", "no line of a compensation table, expected such as"),
    ],
)
def test_sinumerik_lines_that_would_change_a_table_are_refused(more: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        sinumerik.read(CEC + more)
    with pytest.raises(InputError, match="corrects axis Z1 by the position of X1 alone"):
        sinumerik.read(CEC.replace("OUTPUT_AXIS[0]=(X1)", "OUTPUT_AXIS[0]=(Z1)"))


def test_a_sinumerik_table_of_another_ncu_is_refused() -> None:
    with pytest.raises(InputError, match="axis of NCU 2 by one of NCU 1") as caught:
        sinumerik.read(CEC + "$AN_CEC_INPUT_NCU[0]=1\n$AN_CEC_OUTPUT_NCU[0]=2\n")
    assert caught.value.line == 3


PROGRAM = """\
%
O9000
{begin}
N3605 P1 R00000000
N3620 P1 R2
N3621 P1 R1
N3622 P1 R4
N3623 P1 R1
N3624 P1 R{width}
N1851 P1 R3
N10001 R1
N10002 R-1
N10003 R2
N10004 R0
G11
M30
%
"""
PUNCHED = """\
%
N01851Q1A1P3A2P0
N03605Q1A1P00000000A2P00000001;
N03620Q1A1P2A2P0
N03621Q1A1P1A2P0
N03622Q1A1P4A2P0
N03623Q1A1P1A2P1
N03624Q1A1{width}A2{width}
N10001Q0P1
N10002Q0P-1
N10003Q0P2
N10004Q0P0
%
"""


@pytest.mark.parametrize(
    "text",
    [
        PROGRAM.format(begin="G10 L50", width="50000"),
        PROGRAM.format(begin="G10L52;", width="50000"),
        PROGRAM.format(begin="G10 L52", width="50.0").replace("N3605 P1 R00000000", "N3605 P1 Q0 R0\nN3605 P1 Q1 R1"),
        PROGRAM.format(begin="G10 L52", width="50.").replace("N10001", "G11\nG10 L50\nN10001"),
        PUNCHED.format(width="M50.0"),
        PUNCHED.format(width="I1.968503937"),
        PUNCHED.format(width="P50.0"),
        PUNCHED.format(width="P50000").replace("Q1", "").replace("Q0", ""),  # 16i
        PROGRAM.format(begin="N1 G90 G10 L52", width="50.0").replace("G11\nM30", "N2 G11\nN3 M30"),
        PROGRAM.format(begin="G10 L52", width="50.0").replace("O9000", "<PITCH-X>"),
        PUNCHED.format(width="M50.0").replace("P1\n", "P+1\n").replace("%\nN01", "%PARAMETERS\nN01"),
        "\0\0\0\x12" + PUNCHED.format(width="M50.0") + "\x14\0\0",
        PUNCHED.format(width="M50.0").replace("Q1A1", "Q1L1A1").replace("N10", "N00000Q1L1P00000000\nN10", 1),
    ],
)
def test_fanuc_forms_of_one_table(text: str) -> None:
    found = both_directions(fanuc.load(text))
    assert found.position_mm == pytest.approx([-100.0, -50.0, 0.0, 50.0, 100.0])
    assert found.plus_um == pytest.approx([0.0, 1.0, 0.0, 2.0, 2.0])
    assert found.minus_um == pytest.approx([-3.0, -2.0, -3.0, -1.0, -1.0])


@pytest.mark.parametrize(
    ("text", "says", "line"),
    [
        (PUNCHED.format(width="M50.0").replace("P-1", "P-1.5"), "expected a whole number", 10),
        (PUNCHED.format(width="M50.0").replace("N01851", "N03602Q1P00000001\nN01851"), "points are totals", 2),
        ("%\nG54 X0\n", "G10 L50 or G10 L52, or parameters punched out", 2),
        ("%\nG10 L52\nN3620 R1\nG11\n", "lacks its axis", 3),
        ("%\n%\n", "neither a program", None),
    ],
)
def test_fanuc_forms_that_are_not_read_are_named(text: str, says: str, line: int | None) -> None:
    with pytest.raises(InputError, match=says) as caught:
        fanuc.load(text)
    assert caught.value.line == line


@pytest.mark.parametrize(("series", "begin"), [("16i", "G10 L50"), ("30i", "G10 L52")])
@pytest.mark.parametrize("one_way", [False, True])
def test_a_fanuc_export_says_which_series_it_is_for(series: str, begin: str, one_way: bool) -> None:
    tables = build(3, equidistant=True, constant_backlash=True)
    chosen = FanucSettings(
        series=series,
        allow_shift=True,
        tolerance_um=1.0,
        magnification=5,
        reference_mm=float(tables.nodes_mm[0]),
        bidirectional=not one_way,
    )
    made = fanuc.export(tables, chosen)
    assert made.text.splitlines()[2] == begin
    assert any(begin in note and f"series {series}" in note for note in made.notes)
    other = "30i" if series == "16i" else "16i"
    assert any(f"--series {other}" in note for note in made.notes)
    assert (
        fanuc.load(made.text, chosen).digest()
        == fanuc.load(fanuc.export(tables, replace(chosen, series=other)).text, chosen).digest()
    )
