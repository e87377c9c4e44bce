"""Manual mode's table files: what they say, and how every way of getting one wrong is refused."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from hil.correction.manual import manual_text, read_backlash, read_manual_tables, read_signs, read_straightness
from hil.correction.tables import DirectionalTable, TableMode


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "typed.csv"


def test_two_directions(path: Path) -> None:
    path.write_text("\ufeff# typed by hand\nposition_mm, plus_um, minus_um\n\n0,1,4\r\n100,2,6\n", encoding="utf-8")
    tables = read_manual_tables(path)
    assert tables.mode is TableMode.BIDIRECTIONAL
    assert (float(tables.correction_um(50.0, 1)), float(tables.correction_um(50.0, -1))) == (1.5, 5.0)
    assert (tables.specified, tables.straightness) == (None, None)
    assert tables.backlash is not None
    assert tables.backlash.value_um.tolist() == [1 - 4, 2 - 6]


def test_one_direction_and_a_backlash_counted_once(path: Path) -> None:
    path.write_text("position_mm,plus_um,backlash_um\n0,1,10\n100,2,12\n")
    tables = read_manual_tables(path)
    assert tables.mode is TableMode.UNIDIRECTIONAL_BACKLASH
    assert tables.pitch.minus_um.tolist() == [1 - 10, 2 - 12]
    np.testing.assert_allclose(tables.correction_um([0.0, 100.0], 1), [1, 2])
    np.testing.assert_allclose(tables.correction_um([0.0, 100.0], -1), [1 - 10, 2 - 12])


def test_a_backlash_beside_both_directions_takes_the_place_of_their_difference(path: Path) -> None:
    path.write_text("position_mm,plus_um,minus_um,backlash_um\n0,4,0,10\n100,2,-2,12\n")
    tables = read_manual_tables(path)
    assert tables.mode is TableMode.MEAN_BACKLASH
    assert tables.correction_um([0.0, 100.0], 1).tolist() == [2 + 5, 0 + 6]
    assert tables.correction_um([0.0, 100.0], -1).tolist() == [2 - 5, 0 - 6]
    written = path.with_name("written.csv")
    written.write_text(manual_text(tables))
    assert read_manual_tables(written) == tables


def test_a_backlash_on_positions_of_its_own(path: Path, tmp_path: Path) -> None:
    beside = tmp_path / "backlash.csv"
    beside.write_text("# by torque\nposition_mm,backlash_um\n30,10\n60,16\n")
    backlash = read_backlash(beside)
    path.write_text("position_mm,plus_um\n0,1\n100,2\n")
    one = read_manual_tables(path, backlash)
    assert one.mode is TableMode.UNIDIRECTIONAL_BACKLASH
    assert one.backlash == backlash
    assert one.correction_um([0.0, 50.0, 100.0], -1).tolist() == [1 - 10, 1.5 - 14, 2 - 16]
    path.write_text("position_mm,plus_um,minus_um\n0,1,3\n100,2,4\n")
    assert float(read_manual_tables(path, backlash).correction_um(30.0, 1)) == pytest.approx(2.3 + 5)
    path.write_text("position_mm,plus_um,backlash_um\n0,1,10\n")
    with pytest.raises(InputError, match="it would count twice"):
        read_manual_tables(path, backlash)
    beside.write_text("position_mm,backlash_um\n60,10\n30,16\n")
    with pytest.raises(InputError, match=r"backlash\.csv.*ascending"):
        read_backlash(beside)


def test_specified_accuracy_and_straightness_add_up(path: Path) -> None:
    path.write_text(
        "position_mm,plus_um,minus_um,specified_plus_um,specified_minus_um,straightness_um\n0,1,4,6.5,6.4,0.25\n100,2,6,6.5,6.4,0.25\n"
    )
    tables = read_manual_tables(path)
    assert (float(tables.correction_um(0.0, 1)), float(tables.correction_um(0.0, -1))) == (7.75, 10.65)


def test_a_straightness_correction_is_minus_the_deviation(path: Path) -> None:
    path.write_text("position_mm,deviation_um\n0,3\n100,-5\n")
    assert read_straightness(path) == DirectionalTable.alike([0, 100], [-3, 5])
    path.write_text("position_mm,deviation_plus_um,deviation_minus_um\n0,3,1\n100,-5,2\n")
    assert read_straightness(path) == DirectionalTable(
        *(np.array(c) for c in ([0.0, 100.0], [-3.0, 5.0], [-1.0, -2.0]))
    )
    for header in ("position_mm,deviation_plus_um", "position_mm,deviation_um,deviation_plus_um", "position_mm"):
        path.write_text(header + "\n" + ",".join("1" for _ in header.split(",")) + "\n")
        with pytest.raises(InputError, match="deviation_um"):
            read_straightness(path)


HEAD = "position_mm,plus_um,minus_um\n"


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", None, "holds no table"),
        (HEAD, None, "holds no table"),
        ("0,1,2\n3,4,5\n", 1, "unknown column '0'"),
        ("position_mm,plus_um\n0,1\n", 1, "needs minus_um, or backlash_um, or a backlash beside it"),
        ("plus_um,minus_um\n0,1\n", 1, "lacks position_mm"),
        ("position_mm,plus_um,plus_um\n0,1,1\n", 1, "twice"),
        ("position_mm,plus_um,minus_um,specified_plus_um\n0,1,1,1\n", 1, "both specified_plus_um and"),
        (HEAD + "0,1\n", 2, "row has 2 columns, expected 3"),
        (HEAD + "# a remark\n\n0,1,2\n10,1,nan\n", 5, "minus_um is 'nan'"),
        (HEAD + "0,1,inf\n", 2, "minus_um is 'inf'"),
        (HEAD + "0,1,\n", 2, "minus_um is ''"),
        (HEAD + "0,1_0,2\n", 2, "plus_um is '1_0'"),
        (HEAD + "0;1;2\n", 2, "row has 1 columns"),
        (HEAD.replace(",", ";") + "0;1;2,5\n", 2, "minus_um is '2,5', expected a finite number with a decimal point"),
        (HEAD + "0,0,0.002\n100,100.003,100.001\n200,199.998,200\n", 1, "plus_um repeats the positions in mm"),
        (HEAD + '"0,1,2\n', 2, "position_mm is '\"0'"),
        (HEAD + "0,1," + "9" * 200_000 + "\n", 2, "minus_um is '9999"),
        (HEAD + "10,1,2\n0,1,2\n", None, "strictly ascending"),
        (HEAD + "0,1,2\n0,1,2\n", None, "strictly ascending"),
    ],
)
def test_what_is_no_table_is_refused_with_its_place(path: Path, text: str, line: int | None, words: str) -> None:
    path.write_text(text)
    with pytest.raises(InputError, match=re.escape(words)) as refused:
        read_manual_tables(path)
    assert (refused.value.path, refused.value.line) == (str(path), line)
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize("saved", ["{};", "sep=;\n{};", '"{}"', "{}\t\t"])
def test_a_table_as_it_is_pasted_or_saved_by_a_spreadsheet(path: Path, saved: str) -> None:
    path.write_text(HEAD + "0,1,2\n10,-1.5,2\n")
    plain = read_manual_tables(path)
    mark = "\t" if "\t" in saved else ";" if ";" in saved else '","'
    rows = [row.replace(",", mark) for row in path.read_text().splitlines()]
    begin, _, row = saved.rpartition("\n")
    path.write_text("\n".join(filter(None, [begin, *map(row.format, rows)])))
    assert read_manual_tables(path).digest() == plain.digest()


def test_bytes_that_are_no_text(path: Path) -> None:
    path.write_bytes(HEAD.encode() + b"0,1,\xff\n")
    with pytest.raises(InputError, match=r"typed\.csv:2: byte FFh is not UTF-8 text"):
        read_manual_tables(path)


def test_signs_of_sections(path: Path) -> None:
    path.write_text("from_mm,to_mm,plus,minus\n0,100,1,-1\n100,250,-1,-1\n")
    first, second = read_signs(path)
    assert (first.from_mm, first.to_mm, first.plus, first.minus) == (0.0, 100.0, 1, -1)
    assert (second.from_mm, second.to_mm, second.plus, second.minus) == (100.0, 250.0, -1, -1)
    (typed,) = read_signs(path, "from_mm,to_mm,plus,minus\n0,50,-1,1\n")  # in place of the file's
    assert (typed.to_mm, typed.plus, typed.minus) == (50.0, -1, 1)
    assert read_signs(path, "from_mm,to_mm,plus,minus\n") == ()
    for wrong in ("2", "0", "-0.5"):
        path.write_text(f"from_mm,to_mm,plus,minus\n0,100,1,{wrong}\n")
        with pytest.raises(InputError, match=re.escape(str(path))):
            read_signs(path)
