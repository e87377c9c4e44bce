"""System A's arithmetic (JP4875672B2), against worked numbers and as properties of random tables."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from hil.correction.tables import (
    Band,
    DirectionalTable,
    OutsideBand,
    SectionMeans,
    SignedSections,
    SingleTable,
    TableMode,
    TableSet,
    compute_tables,
    initial_specified,
    judge,
    revise,
    revised_value_um,
    section_means,
    sections_outside,
    split_specified,
    straightness_table,
)
from hil.records.rows import Records

amounts = st.floats(-300, 300)
shares = st.floats(0, 1)


@st.composite
def nodes(draw: st.DrawFn) -> list[float]:
    return sorted(draw(st.lists(st.integers(0, 10**6).map(lambda n: n / 1000), min_size=1, max_size=7, unique=True)))


def column(draw: st.DrawFn, count: int) -> list[float]:
    return draw(st.lists(amounts, min_size=count, max_size=count))


@st.composite
def single_tables(draw: st.DrawFn) -> SingleTable:
    positions = draw(nodes())
    return SingleTable(np.array(positions), np.array(column(draw, len(positions))))


@st.composite
def directional_tables(draw: st.DrawFn) -> DirectionalTable:
    positions = draw(nodes())
    plus, minus = column(draw, len(positions)), column(draw, len(positions))
    return DirectionalTable(np.array(positions), np.array(plus), np.array(minus))


@st.composite
def table_sets(draw: st.DrawFn, cross_axis: bool = True) -> TableSet:
    """Any combination of tables, each with sections of its own."""
    mode = draw(st.sampled_from(TableMode))
    backlash = draw(st.none() | single_tables() if mode is TableMode.BIDIRECTIONAL else single_tables())
    return TableSet(
        mode,
        draw(directional_tables()),
        backlash,
        draw(st.none() | directional_tables()),
        draw(st.none() | directional_tables()),
        draw(st.sampled_from(["", "Y"])) if cross_axis else "",
    )


def interpolated(position: float, at: np.ndarray, values: np.ndarray) -> float:
    """Linear between sections, the end value beyond them; in exact fractions and by a search of its own."""
    if position <= at[0]:
        return float(values[0])
    for (low, low_value), (high, high_value) in pairwise(zip(at.tolist(), values.tolist(), strict=True)):
        if low <= position <= high:
            share = (Fraction(position) - Fraction(low)) / (Fraction(high) - Fraction(low))
            return float(Fraction(low_value) + share * (Fraction(high_value) - Fraction(low_value)))
    return float(values[-1])


def expected_correction_um(tables: TableSet, position: float, direction: int) -> float:
    """What the tables say, the backlash counted once and only where the pitch table has one direction."""
    plus = interpolated(position, tables.pitch.position_mm, tables.pitch.plus_um)
    if tables.mode is TableMode.BIDIRECTIONAL:
        total = plus if direction > 0 else interpolated(position, tables.pitch.position_mm, tables.pitch.minus_um)
    else:
        assert tables.backlash is not None
        total, amount = plus, interpolated(position, tables.backlash.position_mm, tables.backlash.value_um)
        if tables.mode is TableMode.MEAN_BACKLASH:
            minus = interpolated(position, tables.pitch.position_mm, tables.pitch.minus_um)
            total = plus / 2 + minus / 2 + direction * amount / 2
        elif direction < 0:
            total -= amount
    if tables.specified is not None:
        column = tables.specified.plus_um if direction > 0 else tables.specified.minus_um
        total += interpolated(position, tables.specified.position_mm, column)
    if tables.straightness is not None and tables.straightness_axis == "":
        total += interpolated(
            position,
            tables.straightness.position_mm,
            tables.straightness.plus_um if direction > 0 else tables.straightness.minus_um,
        )
    return total


POSITIONS = st.lists(st.floats(-100, 1100), min_size=1, max_size=10)


@given(table_sets(), POSITIONS, st.sampled_from([1, -1]))
@settings(max_examples=60)
def test_correction_is_what_an_exact_interpolation_gives(tables: TableSet, at: list[float], direction: int) -> None:
    found = tables.correction_um(np.array(at), direction)
    expected = [expected_correction_um(tables, position, direction) for position in at]
    assert found == pytest.approx(expected, abs=1e-9)


@given(table_sets(), POSITIONS, st.sampled_from([1, -1]))
@settings(max_examples=60)
def test_one_combined_store_gives_the_same_output_everywhere(tables: TableSet, at: list[float], direction: int) -> None:
    combined = tables.combined()
    assert combined.specified is None
    assert combined.correction_um(np.array(at), direction) == pytest.approx(
        tables.correction_um(np.array(at), direction), abs=1e-9
    )


def test_by_steps_each_section_keeps_the_value_of_its_target() -> None:
    """Sections of 100 mm around the targets; 5 µm from the change on, within a ramp of 1 µm, and beyond the ends."""
    at = np.array([0.0, 100.0, 200.0])
    pitch = DirectionalTable(at, np.array([1.0, 5.0, -3.0]), np.array([2.0, 7.0, 0.0]))
    own = DirectionalTable(at, np.array([0.5, 0.5, 0.0]), np.array([0.0, 0.5, 0.5]))
    tables = TableSet(
        TableMode.BIDIRECTIONAL, pitch, specified=DirectionalTable.constant(at, 6.0), straightness=own
    ).stepped()
    where = np.array([-30.0, 0.0, 49.99, 50.0, 50.01, 100.0, 149.9, 150.1, 200.0, 260.0])
    assert tables.correction_um(where, 1) == pytest.approx([7.5, 7.5, 7.5, 9.5, 11.5, 11.5, 11.5, 3.0, 3.0, 3.0])
    assert tables.correction_um(where[[1, 4, 9]], -1) == pytest.approx([8.0, 13.5, 6.5])
    one = TableSet(TableMode.UNIDIRECTIONAL_BACKLASH, pitch, SingleTable(at, np.array([4.0, 8.0, 2.0]))).stepped()
    assert one.correction_um([49.0, 51.0], -1) == pytest.approx([1.0 - 4.0, 5.0 - 8.0])
    with pytest.raises(InputError, match=r"sections of 0\.001 mm: expected at least 0\.002 mm"):
        TableSet.zero(np.array([0.0, 0.001])).stepped()


def test_straightness_stored_before_it_had_directions_is_read_for_both() -> None:
    at = [0.0, 100.0]
    plain = {**TableSet.zero(np.array(at)).to_dict(), "straightness": {"position_mm": at, "value_um": [0.5, -0.5]}}
    assert TableSet.from_dict(plain).straightness == DirectionalTable.alike(at, [0.5, -0.5])


@given(table_sets(cross_axis=False), POSITIONS, st.sampled_from([1, -1]), shares)
@settings(max_examples=60)
def test_sharing_out_to_straightness_keeps_the_total_everywhere(
    tables: TableSet, at: list[float], direction: int, share: float
) -> None:
    if tables.specified is None:
        with pytest.raises(InputError, match="needs a specified accuracy"):
            split_specified(tables, share)
        return
    split = split_specified(tables, share)
    assert split.correction_um(np.array(at), direction) == pytest.approx(
        tables.correction_um(np.array(at), direction), abs=1e-9
    )


def test_the_share_moved_to_straightness_is_that_share() -> None:
    at = np.array([0.0, 100.0])
    tables = TableSet(
        TableMode.BIDIRECTIONAL,
        DirectionalTable(at, np.array([1.0, 2.0]), np.array([3.0, 4.0])),
        specified=DirectionalTable(at, np.array([6.0, 7.0]), np.array([7.0, 7.0])),
        straightness=DirectionalTable(at, np.array([0.5, -0.5]), np.array([0.25, 0.5])),
    )
    split = split_specified(tables, 0.4)
    assert split.straightness is not None
    assert split.straightness.plus_um == pytest.approx([0.5 + 0.4 * 6.0, -0.5 + 0.4 * 7.0])
    assert split.straightness.minus_um == pytest.approx([0.25 + 0.4 * 7.0, 0.5 + 0.4 * 7.0])
    assert split.pitch.plus_um == pytest.approx([1.0 + 0.6 * 6.0, 2.0 + 0.6 * 7.0])
    assert split.pitch.minus_um == pytest.approx([3.0 + 0.6 * 7.0, 4.0 + 0.6 * 7.0])


@pytest.mark.parametrize("share", [-0.1, 1.1, math.nan, math.inf])
def test_a_share_outside_0_to_1_is_refused(share: float) -> None:
    tables = replace(TableSet.zero(np.array([0.0])), specified=DirectionalTable.constant(np.array([0.0]), 1.0))
    with pytest.raises(InputError, match="share"):
        split_specified(tables, share)


def test_a_table_that_corrects_another_axis_takes_no_share_and_adds_nothing_here() -> None:
    at = np.array([0.0, 10.0])
    tables = replace(
        TableSet.zero(at),
        specified=DirectionalTable.constant(at, 6.5),
        straightness=straightness_table(at, [2.0, -3.0], [4.0, 5.0]),
        straightness_axis="Y",
    )
    assert tables.correction_um(at, 1).tolist() == [6.5, 6.5]
    assert tables.cross_correction_um(at, 1, "Y").tolist() == [-2.0, 3.0]
    assert tables.cross_correction_um(at, -1, "Y").tolist() == [-4.0, -5.0]
    assert tables.cross_correction_um(at, 1, "Z").tolist() == [0.0, 0.0]
    assert tables.cross_correction_um(at, 1, "").tolist() == [0.0, 0.0]
    with pytest.raises(InputError, match="axis Y"):
        split_specified(tables, 0.5)


def test_combining_keeps_a_backlash_that_was_entered_by_hand() -> None:
    """D may be measured by other means and have sections of its own; E = F changes nothing about it."""
    at = np.array([0.0, 100.0])
    by_hand = SingleTable(np.array([50.0]), np.array([12.0]))
    tables = TableSet(
        TableMode.BIDIRECTIONAL,
        DirectionalTable(at, np.array([1.0, 1.0]), np.array([-4.0, -4.0])),
        by_hand,
        DirectionalTable.constant(at, 6.5),
    )
    combined = tables.combined()
    assert combined.backlash is not None
    assert combined.backlash.at([0.0, 50.0, 100.0]).tolist() == [12.0, 12.0, 12.0]


# -- plain form ----------------------------------------------------------------------------------------------------------


@given(table_sets())
@settings(max_examples=60)
def test_plain_form_gives_the_tables_back_bit_for_bit(tables: TableSet) -> None:
    again = TableSet.from_dict(json.loads(json.dumps(tables.to_dict())))
    assert again == tables
    assert hash(again) == hash(tables)
    assert json.dumps(again.to_dict()) == json.dumps(tables.to_dict())  # tells 0.0 from -0.0 as well
    assert again.digest() == tables.digest()


def test_the_digest_tells_tables_apart_by_one_bit() -> None:
    one = TableSet.zero(np.array([0.0, 1.0]))
    other = replace(one, pitch=DirectionalTable(np.array([0.0, 1.0]), np.array([0.0, 5e-324]), np.array([0.0, 0.0])))
    assert one != other
    assert one.digest() != other.digest()


def test_the_digest_is_that_of_the_plain_form_with_its_keys_in_order() -> None:
    """The text by hand: reports of earlier versions name tables by the same digest."""
    at = np.array([0.0, 10.0])
    tables = TableSet(
        TableMode.UNIDIRECTIONAL_BACKLASH,
        DirectionalTable(at, np.array([1.0, 2.5]), np.array([3.0, -4.0])),
        SingleTable(np.array([5.0]), np.array([6.0])),
        straightness_axis="Y",
    )
    text = (
        '{"backlash":{"position_mm":[5.0],"value_um":[6.0]},"format":"hil-tables/1","mode":"unidirectional+backlash",'
        '"pitch":{"minus_um":[3.0,-4.0],"plus_um":[1.0,2.5],"position_mm":[0.0,10.0]},'
        '"specified":null,"straightness":null,"straightness_axis":"Y"}'
    )
    assert tables.digest() == hashlib.sha256(text.encode()).hexdigest()


def test_tables_are_equal_by_their_kind_and_all_their_numbers() -> None:
    at, values = np.array([0.0, 1.0]), np.array([1.0, 2.0])
    one = SingleTable(at, values)
    assert one == SingleTable(at.copy(), values.copy())
    assert one != SingleTable(at, np.array([1.0, 2.5]))
    assert one != SingleTable(np.array([0.0, 1.5]), values)
    assert one != DirectionalTable(at, values, values)
    assert one != (at, values)


def plain(**changed: Any) -> dict[str, Any]:
    form = TableSet(
        TableMode.UNIDIRECTIONAL_BACKLASH,
        DirectionalTable(np.array([0.0, 1.0]), np.array([1.0, 2.0]), np.array([3.0, 4.0])),
        SingleTable(np.array([0.0]), np.array([5.0])),
    ).to_dict()
    return {**form, **changed}


def pitch(**changed: Any) -> dict[str, Any]:
    return {"pitch": {"position_mm": [0.0, 1.0], "plus_um": [1.0, 2.0], "minus_um": [3.0, 4.0], **changed}}


MALFORMED: dict[str, tuple[Any, str]] = {
    "not a mapping": ([1, 2], "list"),
    "no format": ({}, "None"),
    "another format": (plain(format="hil-tables/2"), "hil-tables/2"),
    "another mode": (plain(mode="both"), "both"),
    "a list as mode": (plain(mode=["bidirectional"]), "mode"),
    "an unknown entry": (plain(operator="me"), "operator"),
    "an entry missing": ({key: value for key, value in plain().items() if key != "specified"}, "specified"),
    "no pitch": (plain(pitch=None), "pitch"),
    "no backlash in one direction": (plain(backlash=None), "backlash"),
    "a number as table": (plain(pitch=5), "pitch"),
    "an unknown column": (plain(**pitch(sideways_um=[1, 2])), "sideways_um"),
    "a column missing": (plain(pitch={"position_mm": [0.0], "plus_um": [0.0]}), "minus_um"),
    "a column that is no list": (plain(**pitch(plus_um=1.0)), "pitch.plus_um"),
    "lengths that differ": (plain(**pitch(plus_um=[1.0])), "pitch: plus_um"),
    "a backlash of another length": (
        plain(backlash={"position_mm": [0.0, 1.0], "value_um": [5.0]}),
        "backlash: value_um has 1 values for 2 positions",
    ),
    "true as a number": (plain(**pitch(plus_um=[True, 1.0])), "True"),
    "text as a number": (plain(**pitch(plus_um=["1", 1.0])), "'1'"),
    "null as a number": (plain(**pitch(minus_um=[None, 1.0])), "None"),
    "a list as a number": (plain(**pitch(minus_um=[[1.0], 1.0])), "minus_um"),
    "nan": (plain(**pitch(plus_um=[math.nan, 1.0])), "finite"),
    "infinity": (plain(**pitch(plus_um=[math.inf, 1.0])), "finite"),
    "an integer beyond floats": (plain(**pitch(plus_um=[10**400, 1.0])), "finite"),
    "positions that fall": (plain(**pitch(position_mm=[1.0, 0.0])), "ascending"),
    "positions that stand": (plain(**pitch(position_mm=[1.0, 1.0])), "ascending"),
    "no positions": (plain(**pitch(position_mm=[], plus_um=[], minus_um=[])), "at least one"),
    "a number as axis name": (plain(straightness_axis=5), "straightness_axis"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_plain_form_is_refused_in_one_line(case: str) -> None:
    data, said = MALFORMED[case]
    with pytest.raises(InputError) as caught:
        TableSet.from_dict(data)
    assert said in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("direction", [0, 0.0, 2, math.nan, [1, 0]])
def test_a_direction_that_is_neither_plus_nor_minus_is_refused_not_guessed(direction: Any) -> None:
    at = np.array([0.0, 1.0])
    one_directional = TableSet(
        TableMode.UNIDIRECTIONAL_BACKLASH, DirectionalTable.constant(at, 1.0), SingleTable(at, np.array([4.0, 4.0]))
    )
    for tables in (TableSet.zero(at), one_directional):
        with pytest.raises(InputError, match="direction"):
            tables.correction_um(at, direction)


def test_scaled_corrections_are_so_many_times_as_large() -> None:
    scaled = DirectionalTable(np.array([0.0, 1.0]), np.array([1.0, 2.0]), np.array([3.0, -4.0])).scaled(4.0)
    assert (scaled.plus_um.tolist(), scaled.minus_um.tolist()) == ([4.0, 8.0], [12.0, -16.0])


def test_the_sum_of_two_tables_holds_the_nodes_and_each_direction_of_both() -> None:
    """Midway, at 50 mm, the first is 15 µm in + and 150 in −."""
    one = DirectionalTable(np.array([0.0, 100.0]), np.array([10.0, 20.0]), np.array([100.0, 200.0]))
    total = one.plus(DirectionalTable(np.array([50.0]), np.array([3.0]), np.array([-7.0])))
    assert total.position_mm.tolist() == [0.0, 50.0, 100.0]
    assert total.plus_um.tolist() == [13.0, 18.0, 23.0]
    assert total.minus_um.tolist() == [93.0, 143.0, 193.0]


def test_a_backlash_that_is_not_added_has_no_nodes() -> None:
    """Beside tables of both directions it is knowledge alone."""
    two = DirectionalTable.constant(np.array([0.0, 100.0]), 1.0)
    backlash = SingleTable(np.array([30.0]), np.array([4.0]))
    assert TableSet(TableMode.BIDIRECTIONAL, two, backlash).nodes_mm.tolist() == [0.0, 100.0]
    assert TableSet(TableMode.MEAN_BACKLASH, two, backlash).nodes_mm.tolist() == [0.0, 30.0, 100.0]


def test_tables_whose_directions_differ_at_one_place_correct_a_reversal() -> None:
    at = np.array([0.0, 50.0, 100.0])
    same = DirectionalTable(at, np.array([1.0, 2.0, 3.0]), np.array([1.0, 2.0, 3.0]))
    assert not TableSet(TableMode.BIDIRECTIONAL, same).corrects_reversal
    assert TableSet(TableMode.BIDIRECTIONAL, replace(same, minus_um=np.array([1.0, 2.5, 3.0]))).corrects_reversal


def test_tables_do_not_follow_their_source_and_cannot_be_written_to() -> None:
    source = np.array([1.0, 2.0])
    table = SingleTable(np.array([0.0, 1.0]), source)
    source[0] = 9.0
    assert table.value_um[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        table.value_um[0] = 5.0


# -- measuring -----------------------------------------------------------------------------------------------------------


def worked_records(order: list[int] | None = None) -> Records:
    """Three sections, two runs; by hand: A = 0, 100, 200 mm.

    B, mean of + runs: -2 µm, +4 µm, +9 µm off the target; C, mean of - runs: +3 µm, +10 µm, +11 µm off.
    """
    rows = [
        (1, +1, 0.0, -0.0025),
        (1, +1, 100.0, 100.0038),
        (1, +1, 200.0, 200.0090),
        (1, -1, 200.0, 200.0110),
        (1, -1, 100.0, 100.0100),
        (1, -1, 0.0, 0.0030),
        (2, +1, 0.0, -0.0015),
        (2, +1, 100.0, 100.0042),
        (2, +1, 200.0, 200.0090),
        (2, -1, 200.0, 200.0110),
        (2, -1, 100.0, 100.0100),
        (2, -1, 0.0, 0.0030),
    ]
    table = np.array([rows[i] for i in (order or range(len(rows)))], dtype=float)
    return Records.of(
        {"run": table[:, 0], "direction": table[:, 1], "target_mm": table[:, 2], "measured_mm": table[:, 3]}
    )


@pytest.mark.parametrize("mode", TableMode)
def test_tables_of_the_worked_example(mode: TableMode) -> None:
    tables = compute_tables(worked_records(), mode)
    assert tables.pitch.position_mm.tolist() == [0.0, 100.0, 200.0]
    assert tables.pitch.plus_um == pytest.approx([2.0, -4.0, -9.0])  # A - B
    assert tables.pitch.minus_um == pytest.approx([-3.0, -10.0, -11.0])  # A - C
    assert tables.backlash is not None
    assert tables.backlash.value_um == pytest.approx([5.0, 6.0, 2.0])  # D = C - B
    assert tables.correction_um([0, 100, 200, 50], 1) == pytest.approx([2.0, -4.0, -9.0, -1.0])
    assert tables.correction_um([0, 100, 200, 50], -1) == pytest.approx([-3.0, -10.0, -11.0, -6.5])


def test_means_and_pooled_standard_deviation_of_the_worked_example() -> None:
    means = section_means(worked_records())
    assert means.plus_um == pytest.approx([-2.0, 4.0, 9.0])
    assert means.minus_um == pytest.approx([3.0, 10.0, 11.0])
    # squares: 2·0.5² + 2·0.2² = 0.58, and six sections of two runs have 6 degrees of freedom
    assert means.pooled_std_um == pytest.approx(math.sqrt(0.58 / 6))


@given(st.permutations(range(12)))
@settings(max_examples=30)
def test_the_order_of_rows_does_not_matter(order: list[int]) -> None:
    tables, shuffled = compute_tables(worked_records()), compute_tables(worked_records(order))
    assert shuffled.pitch.plus_um == pytest.approx(tables.pitch.plus_um)
    assert shuffled.pitch.minus_um == pytest.approx(tables.pitch.minus_um)


@st.composite
def measured(draw: st.DrawFn) -> Records:
    targets, runs = draw(nodes()), draw(st.integers(1, 3))
    rows = [
        (run, direction, target, target + draw(amounts) / 1000)
        for run in range(1, runs + 1)
        for direction in (1, -1)
        for target in targets[::direction]
    ]
    table = np.array(rows)
    return Records.of(dict(zip(("run", "direction", "target_mm", "measured_mm"), table.T, strict=True)))


@given(measured(), st.lists(st.floats(-50, 1050), min_size=1, max_size=5))
@settings(max_examples=40)
def test_one_direction_and_backlash_equals_both_directions_everywhere(rows: Records, between: list[float]) -> None:
    both = compute_tables(rows, TableMode.BIDIRECTIONAL)
    one = compute_tables(rows, TableMode.UNIDIRECTIONAL_BACKLASH)
    at = np.concatenate([both.pitch.position_mm, between])
    for direction in (1, -1):
        assert one.correction_um(at, direction) == pytest.approx(both.correction_um(at, direction), abs=1e-9)
    assert both.correction_um(both.pitch.position_mm, 1).tolist() == both.pitch.plus_um.tolist()
    assert both.correction_um(both.pitch.position_mm, -1).tolist() == both.pitch.minus_um.tolist()


def test_a_backlash_measured_by_other_means_counts_once_on_its_own_positions() -> None:
    """Pitch +2 and -8 µm at 0, +4 and -10 µm at 100 mm: means -3 and -3. Entered D: 6 µm at 50 mm, 8 µm at 100 mm."""
    at = np.array([0.0, 100.0])
    both = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(at, np.array([2.0, 4.0]), np.array([-8.0, -10.0])))
    entered = both.with_backlash(SingleTable(np.array([50.0, 100.0]), np.array([6.0, 8.0])))
    where = np.array([0.0, 50.0, 75.0, 100.0])
    assert entered.correction_um(where, 1).tolist() == [0.0, 0.0, 0.5, 1.0]
    assert entered.correction_um(where, -1).tolist() == [-6.0, -6.0, -6.5, -7.0]
    assert entered.nodes_mm.tolist() == [0.0, 50.0, 100.0]
    assert TableSet.from_dict(entered.to_dict()) == entered
    again = entered.with_backlash(SingleTable(np.array([0.0]), np.array([10.0])))
    assert again.correction_um(where, 1).tolist() == [2.0] * 4, "from the pitch as measured, not from the one before"
    one = TableSet(TableMode.UNIDIRECTIONAL_BACKLASH, both.pitch, SingleTable(at, np.array([1.0, 1.0])))
    changed = one.with_backlash(SingleTable(np.array([0.0]), np.array([5.0])))
    assert changed.correction_um(at, 1).tolist() == [2.0, 4.0]
    assert changed.correction_um(at, -1).tolist() == [-3.0, -1.0]


@given(table_sets(cross_axis=False), POSITIONS)
@settings(max_examples=40)
def test_the_two_directions_differ_by_the_entered_backlash_alone(tables: TableSet, at: list[float]) -> None:
    amount = SingleTable(np.array([-20.0, 40.0]), np.array([3.0, 11.0]))
    entered = tables.with_backlash(amount)
    own = entered.pitch_um(at, 1) - entered.pitch_um(at, -1)
    assert own == pytest.approx(amount.at(at), abs=1e-6)


def test_runs_measured_with_a_correction_in_force_give_the_same_tables() -> None:
    plain = worked_records()
    command = plain.target_mm + np.where(plain.direction > 0, 0.0123, -0.0321)
    shifted = plain.with_column("measured_mm", plain.measured_mm + (command - plain.target_mm))
    corrected = compute_tables(shifted.with_column("command_mm", command))
    assert corrected.pitch.plus_um == pytest.approx(compute_tables(plain).pitch.plus_um)
    assert corrected.pitch.minus_um == pytest.approx(compute_tables(plain).pitch.minus_um)


@pytest.mark.parametrize("mode", TableMode)
def test_a_straightness_table_takes_its_part_of_the_error(mode: TableMode) -> None:
    """Errors +2 µm forward and +5 µm backward; straightness adds 0.5 µm: the pitch table adds -2.5 and -5.5, together -2 and -5."""
    rows = [(1, way, p, p + (0.002 if way > 0 else 0.005)) for p in (0.0, 100.0) for way in (1, -1)]
    columns = dict(zip(("run", "direction", "target_mm", "measured_mm"), zip(*rows, strict=True), strict=True))
    straightness = DirectionalTable.constant(np.array([0.0, 100.0]), 0.5)
    found = compute_tables(Records.of(columns), mode, straightness)
    np.testing.assert_allclose(found.pitch.plus_um, [-2.5, -2.5], atol=1e-9)
    np.testing.assert_allclose(found.pitch.minus_um, [-5.5, -5.5], atol=1e-9)
    np.testing.assert_allclose(found.correction_um([50.0, 50.0], [1, -1]), [-2.0, -5.0], atol=1e-9)
    assert found.backlash is not None
    np.testing.assert_allclose(found.backlash.value_um, [3.0, 3.0], atol=1e-9)


def test_targets_are_one_section_to_the_nanometre() -> None:
    """10 and 10.0000004 mm are one section of mean 2 µm and s² = 2; 10.000002 mm, two nanometres on, is another."""
    targets = np.array([10.0, 10.0000004, 10.000002])
    records = Records.of({"run": [1, 2, 3], "direction": [1, 1, 1], "target_mm": targets, "measured_mm": targets})
    means = section_means(records, np.array([1.0, 3.0, 7.0]))
    assert means.target_mm == pytest.approx([10.0, 10.000002], abs=1e-9)
    assert means.plus_um.tolist() == [2.0, 7.0]
    assert np.isnan(means.minus_um).all()
    assert means.pooled_std_um == pytest.approx(2**0.5)


def test_a_section_measured_in_one_direction_only_is_named() -> None:
    rows = worked_records()
    without = rows.where(~((rows.target_mm == 100.0) & (rows.direction < 0)))
    with pytest.raises(InputError, match=r"100 mm .* - direction"):
        compute_tables(without)


# -- specified accuracy ----------------------------------------------------------------------------------------------------

BAND = Band(6.0, 7.0)


def test_the_worked_case_of_the_patent() -> None:
    assert revised_value_um(target_um=0.5, specified_um=6.5, measured_um=6.0) == 7.5


def test_the_first_value_is_the_middle_of_the_band_with_its_sign() -> None:
    for band, middle in ((BAND, 6.5), (Band(-7.0, -6.0), -6.5)):
        table = initial_specified(np.array([0.0, 5.0]), band)
        assert table.plus_um.tolist() == table.minus_um.tolist() == [middle, middle]


def test_only_the_sections_outside_are_revised_and_the_others_stay_bit_for_bit() -> None:
    at = np.array([0.0, 10.0, 20.0])
    table = DirectionalTable(at, np.array([6.5, 6.4, 0.1 + 0.2]), np.array([6.5, 6.6, 6.7]))
    revised = revise(table, [OutsideBand(10.0, 1, 5.4), OutsideBand(20.0, -1, 7.3)], BAND)
    assert revised.plus_um.tolist() == [6.5, pytest.approx(6.4 + 6.5 - 5.4), 0.1 + 0.2]
    assert revised.minus_um.tolist() == [6.5, 6.6, pytest.approx(6.7 + 6.5 - 7.3)]
    assert table.plus_um[1] == 6.4  # the old one is untouched


def test_fine_steps_go_towards_the_band_by_that_step() -> None:
    table = DirectionalTable.constant(np.array([0.0]), 6.5)
    assert revise(table, [OutsideBand(0.0, 1, 5.9)], BAND, fine_step_um=0.1).plus_um[0] == pytest.approx(6.6)
    assert revise(table, [OutsideBand(0.0, -1, 7.1)], BAND, fine_step_um=0.1).minus_um[0] == pytest.approx(6.4)


def test_a_section_the_table_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="15 mm"):
        revise(DirectionalTable.constant(np.array([0.0, 10.0]), 6.5), [OutsideBand(15.0, 1, 5.0)], BAND)


@given(
    st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20), st.floats(0.7, 1.3)), min_size=1, max_size=8),
    st.sampled_from([BAND, Band(-7.0, -6.0), Band(-0.5, 0.5)]),
)
@settings(max_examples=60)
def test_revising_converges_on_machines_whose_tables_are_wrong(
    sections: list[tuple[float, float, float]], band: Band
) -> None:
    """Each section answers with a bias of up to 20 µm per direction and takes the correction up by 70 to 130 %.

    A bias of 20 µm and a middle of 6.5 µm leave at most 0.3^n · 22 µm after n rounds: inside ±0.5 µm after 4.
    """
    at = np.arange(len(sections), dtype=float)
    biases = {1: np.array([row[0] for row in sections]), -1: np.array([row[1] for row in sections])}
    gain = np.array([row[2] for row in sections])
    table = initial_specified(at, band)
    measured_ever = {(float(target), sign) for target in at for sign in (1, -1)}
    for _ in range(5):
        error = {1: biases[1] + gain * table.plus_um, -1: biases[-1] + gain * table.minus_um}
        outside = [
            OutsideBand(target, sign, float(error[sign][int(target)]))
            for target, sign in measured_ever
            if not band.holds(error[sign][int(target)])
        ]
        if not outside:
            break
        old, table = table, revise(table, outside, band)
        touched = {(section.target_mm, section.direction) for section in outside}
        for sign, before, after in ((1, old.plus_um, table.plus_um), (-1, old.minus_um, table.minus_um)):
            for target in at:
                assert (float(target), sign) in touched or before[int(target)] == after[int(target)]
        measured_ever = touched
    else:
        pytest.fail(f"still outside after 5 rounds: {outside}")


def test_sections_outside_are_the_measured_ones_only() -> None:
    rows = Records.of(
        {
            "run": [1, 1, 1, 1],
            "direction": [1, 1, -1, 1],
            "target_mm": [0.0, 10.0, 10.0, 20.0],
            "measured_mm": [0.0065, 10.0059, 10.0060, 20.0071],
        }
    )
    found = sections_outside(section_means(rows), BAND)
    assert [(section.target_mm, section.direction) for section in found] == [(10.0, 1), (20.0, 1)]
    assert [str(section) for section in found] == ["10 mm + (+5.90 µm)", "20 mm + (+7.10 µm)"]


SIGNED = Band(6.0, 7.0, (SignedSections(200.0, 250.0, -1, -1), SignedSections(100.0, 200.0, -1, 1)))
"""-7 to -6 µm from 100 to 250 mm in the + direction, from 200 to 250 mm in the - direction; 6 to 7 µm everywhere else."""


def test_the_sign_of_a_band_is_that_of_the_section_and_direction() -> None:
    places = [99.999, 100.0, 199.999, 200.0, 249.999, 250.0]
    assert [SIGNED.at(place, 1).low_um for place in places] == [6.0, -7.0, -7.0, -7.0, -7.0, 6.0]
    assert [SIGNED.at(place, -1).high_um for place in places] == [7.0, 7.0, 7.0, -6.0, -6.0, 7.0]
    first = initial_specified(np.array([0.0, 100.0, 225.0]), SIGNED)
    assert (first.plus_um.tolist(), first.minus_um.tolist()) == ([6.5, -6.5, -6.5], [6.5, 6.5, -6.5])
    unlike, like = Band(-7.0, -6.0), Band(6.0, 7.0)
    assert SIGNED.stretches(50.0, 300.0) == [
        (50.0, 100.0, like, like),
        (100.0, 200.0, unlike, like),
        (200.0, 250.0, unlike, unlike),
        (250.0, 300.0, like, like),
    ]
    assert SIGNED.stretches(100.0, 200.0) == [(100.0, 200.0, unlike, like)]
    assert (str(like), str(SIGNED)) == ("6 to 7 µm", "6 to 7 µm, with the signs of its sections")
    assert [like.nearest_um(error) for error in (5.0, 6.4, 8.0)] == [6.0, 6.4, 7.0]


def test_signs_of_sections_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(InputError, match="sections from 150 mm have two signs, another ends at 200 mm"):
        Band(6.0, 7.0, (SignedSections(150.0, 250.0), SignedSections(100.0, 200.0)))
    with pytest.raises(InputError, match="from 5 to 5 mm, expected from_mm < to_mm"):
        SignedSections(5.0, 5.0)
    for signs in ((0, 1), (1, 2)):
        with pytest.raises(InputError, match="expected 1 or -1"):
            SignedSections(0.0, 5.0, *signs)


@pytest.mark.parametrize(
    ("place_mm", "direction", "between"),
    [
        (75.0, 1, (50.0, 100.0)),
        (75.0, -1, None),
        (225.0, -1, None),  # 200 and 240 mm have the same sign
        (190.0, -1, (100.0, 200.0)),
        (50.0, 1, None),
        (50.0 + 0.9e-6, 1, None),  # a target to the nanometre
        (50.0 + 2e-6, 1, (50.0, 100.0)),
        (100.0 - 0.9e-6, 1, None),
        (100.0 - 2e-6, 1, (50.0, 100.0)),
        (20.0, 1, None),  # before the first and beyond the last target its correction holds
        (300.0, 1, None),
    ],
)
def test_between_targets_of_different_sign_no_band_is_asked_for(
    place_mm: float, direction: int, between: tuple[float, float] | None
) -> None:
    targets = [50.0, 100.0, 200.0, 240.0]
    assert SIGNED.unlike_targets(place_mm, direction, targets) == between
    assert BAND.unlike_targets(place_mm, direction, targets) is None
    assert SIGNED.unlike_targets(place_mm, direction, []) is None


def test_what_is_not_judged_is_not_outside() -> None:
    """At 75 mm the + direction lies between 6.5 at 50 and -6.5 µm at 100 mm; the - direction was not measured at 100 mm."""
    at = np.array([50.0, 75.0, 100.0])
    means = SectionMeans(at, np.array([6.5, 0.0, 6.5]), np.array([7.5, 7.5, np.nan]), 0.1)
    outside, unlike = judge(means, SIGNED, [50.0, 100.0])
    assert [(one.target_mm, one.direction, one.error_um) for one in outside] == [
        (50.0, -1, 7.5),
        (75.0, -1, 7.5),
        (100.0, 1, 6.5),
    ]
    assert [(one.target_mm, one.direction, one.low_mm, one.high_mm) for one in unlike] == [(75.0, 1, 50.0, 100.0)]
    assert str(unlike[0]).startswith("75 mm +, between the targets 50 and 100 mm: ")
    swapped = SectionMeans(at, np.full(3, 5.0), np.full(3, 5.0), 0.1)
    found = judge(swapped, replace(SIGNED, signs=(SignedSections(60.0, 300.0, -1, -1),)), [50.0, 100.0])
    assert [(one.target_mm, one.direction) for one in found[0]] == [(50.0, 1), (50.0, -1), (100.0, 1), (100.0, -1)]
    assert [(one.target_mm, one.direction) for one in found[1]] == [(75.0, 1), (75.0, -1)]


def test_a_revision_aims_at_the_band_with_its_sign() -> None:
    """-6.5 µm wanted and -5 µm measured: 1.5 µm less; a fine step of 0.1 µm goes down."""
    table = DirectionalTable.constant(np.array([150.0]), -6.0)
    section = OutsideBand(150.0, 1, -5.0)
    assert revise(table, [section], SIGNED).plus_um[0] == pytest.approx(-7.5)
    assert revise(table, [section], SIGNED, fine_step_um=0.1).plus_um[0] == pytest.approx(-6.1)


def test_a_band_narrower_than_the_repeatability_is_refused_with_both_figures() -> None:
    with pytest.raises(InputError, match=r"6 to 6\.1 µm is 0\.10 µm wide.*repeatability of 0\.60 µm"):
        Band(6.0, 6.1).check_repeatability(0.15)
    BAND.check_repeatability(0.15)
    BAND.check_repeatability(0.25)  # 4 s is its width
    with pytest.raises(InputError, match="at least 2 runs"):
        BAND.check_repeatability(math.nan)


@pytest.mark.parametrize("limits", [(7.0, 6.0), (6.0, 6.0), (math.nan, 7.0), (6.0, math.inf)])
def test_a_band_that_is_none_is_refused(limits: tuple[float, float]) -> None:
    with pytest.raises(InputError, match="low < high"):
        Band(*limits)


def test_the_ends_of_a_band_belong_to_it_and_nothing_unmeasured_does() -> None:
    assert BAND.holds([6.0, 7.0, 5.999999, 7.000001, math.nan]).tolist() == [True, True, False, False, False]


@given(directional_tables(), st.integers(0, 100))
def test_many_positions_give_what_single_ones_do(table: DirectionalTable, seed: int) -> None:
    """Many are looked up in a joined table of both directions; at nodes and beyond the ends too."""
    rng = np.random.default_rng(seed)
    first, last = table.position_mm[[0, -1]]
    position = np.concatenate([rng.uniform(first - 100.0, last + 100.0, 1500), np.repeat(table.position_mm, 2)])
    direction = rng.choice([-1.0, 1.0], len(position))
    found = table.at(position, direction)
    each = [np.interp(position, table.position_mm, one) for one in (table.plus_um, table.minus_um)]
    np.testing.assert_allclose(found, np.where(direction > 0, *each), atol=1e-6)
    at_nodes = np.isin(position, table.position_mm)
    assert np.array_equal(found[at_nodes], np.where(direction > 0, *each)[at_nodes])
    with pytest.raises(InputError):
        table.at(position, np.where(position > first, 0.0, 1.0))


def test_places_that_nearly_coincide_are_looked_up_one_direction_at_a_time() -> None:
    table = DirectionalTable(np.array([0.0, 1e-15, 100.0]), np.array([0.0, 5.0, 1.0]), np.array([2.0, 7.0, 3.0]))
    for place, plus_um, minus_um in ((0.0, 0.0, 2.0), (1e-15, 5.0, 7.0)):
        found = table.at(np.full(2000, place), np.repeat([1.0, -1.0], 1000))
        assert (set(found[:1000]), set(found[1000:])) == ({plus_um}, {minus_um})
