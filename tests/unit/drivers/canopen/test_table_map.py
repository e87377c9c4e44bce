"""The map of a CANopen drive's own table: what it may say, and what is refused with file, line and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.canopen.eds import EdsEntry
from drivers.canopen.not_parameters import why_not_written
from drivers.canopen.table_map import load_table_map, shipped_tables
from drivers.cia402.objects import DataType, Entry
from drivers.correction_table import Directions, Nodes, RawFormat, RawTable
from drivers.errors import InputError


def changed(tmp_path: Path, name: str, old: str, new: str) -> Path:
    text = shipped_tables()[name].read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "table.toml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return path


def test_the_shipped_maps() -> None:
    array, domain = load_table_map("simulated_array"), load_table_map("simulated_domain")
    assert (array.description.nodes, array.description.points, array.description.sign) == (Nodes.EQUIDISTANT, 200, 1)
    assert array.description.value == RawFormat("counts", 1.0, -32768, 32767)
    assert array.description.step == RawFormat("counts", 1.0, 0, 2**32 - 1)
    assert (domain.description.nodes, domain.description.sign) == (Nodes.EXPLICIT, -1)
    assert domain.description.value == RawFormat("um", 0.1, -32768, 32767)
    assert [column for column, _ in domain.record] == ["position", "plus", "minus"]
    for key, held in {(0x2310, 0): True, (0x2314, 1): True, (0x2314, 200): True, (0x2314, 201): False}.items():
        assert array.holds(*key) is held
    assert domain.holds(0x2321, 0)
    assert not domain.holds(0x2201, 0)


def test_one_curve_and_a_backlash(tmp_path: Path) -> None:
    path = changed(tmp_path, "simulated_array", 'directions = "both"', 'directions = "backlash"')
    text = path.read_text().replace("minus = {", "backlash = {").replace("2315h:01", "2315h:00")
    path.write_text(text)
    found = load_table_map(path)
    assert found.description.directions is Directions.BACKLASH
    assert found.description.backlash == RawFormat("counts", 1.0, -32768, 32767)
    found.description.check(RawTable((1, 2), (), (), 0, 5, 77))


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("simulated_array", 'form = "array"', 'form = "list"', "form is list, expected array or domain"),
        ("simulated_array", "points = 200", "points = 255", "ends at sub-index 255, expected 254 at most"),
        (
            "simulated_array",
            '"counts"\n\n[table.value]',
            '"inch"\n\n[table.value]',
            "unit is inch, expected counts, rev, um or mm",
        ),
        ("simulated_array", '"2311h:00"', '"6040h"', "expected an object of the maker's, 2000h to 5FFFh"),
        ("simulated_array", '"2311h:00"', '"count"', "object is count, expected an object such as 2310h:01"),
        ("simulated_array", 'type = "u8"', 'type = "f32"', "type is f32, expected i8, i16"),
        ("simulated_array", "off = 0", "off = 1", "expected two different values"),
        ("simulated_array", "step = {", "stepp = {", "unknown key stepp, the nearest known one is step"),
        (
            "simulated_array",
            'step = { object = "2313h:00", type = "u32" }',
            "",
            "objects. lacks step, expected a table",
        ),
        ("simulated_array", "sign = 1", "sign = 0", "sign is 0, expected 1 .a positive value is added"),
        ("simulated_array", 'memory = "ram"', 'memory = "rom"', "memory is rom, expected ram or eeprom"),
        ("simulated_array", '"2315h:01", type = "i16"', '"2315h:01", type = "i32"', "of another type than plus"),
        ("simulated_domain", '"minus:i16"', '"minus:u99"', "expected a list such as"),
        (
            "simulated_domain",
            ', "minus:i16"',
            "",
            "record has position, plus, expected each of plus, minus, position once",
        ),
        ("simulated_domain", "scale = 0.1", "scale = -0.1", "scale is -0.1, expected a number > 0"),
    ],
)
def test_what_cannot_be_a_table_is_refused_with_its_line(
    name: str, old: str, new: str, words: str, tmp_path: Path
) -> None:
    path = changed(tmp_path, name, old, new)
    with pytest.raises(InputError, match=words) as error:
        load_table_map(path)
    assert error.value.path == str(path)
    assert error.value.line is not None


def test_a_map_that_is_not_there_names_the_shipped_ones() -> None:
    with pytest.raises(InputError, match=r"neither a file nor a shipped table map \(simulated_array, simulated_domain"):
        load_table_map("nowhere")


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        (RawTable((1,) * 201, (1,) * 201, (), 0, 5), "holds 200 points, 201 were to be written"),
        (RawTable((1, 2), (1,), (), 0, 5), "column minus has 1 values, expected 2"),
        (RawTable((1, 2), (1, 2), (1, 2), 0, 5), "column position has 2 values, expected 0"),
        (RawTable((1, 2), (1, 2), (), 0, 0), "the step is 0, expected more than 0"),
        (RawTable((1, 40_000), (1, 2), (), 0, 5), "plus 40000, allowed is -32768 to 32767"),
        (RawTable((1, 2), (1, 2), (), 2**31, 5), "position 2147483648, allowed is"),
    ],
)
def test_contents_that_cannot_be_held(raw: RawTable, words: str) -> None:
    with pytest.raises(InputError, match=words):
        load_table_map("simulated_array").description.check(raw)


def test_positions_ascend() -> None:
    with pytest.raises(InputError, match="positions do not ascend"):
        load_table_map("simulated_domain").description.check(RawTable((1, 2), (1, 2), (5, 5)))


def test_its_objects_are_no_parameters_of_their_own() -> None:
    entry = EdsEntry(Entry(0x2310, 0, DataType.U8, "pitch table active"), "rw", None, None, None, None, False)
    assert why_not_written(entry) is None
    refusal = why_not_written(entry, load_table_map("simulated_array"))
    assert refusal is not None
    assert "hil params table" in refusal
