"""A parameter set as a file: what is written is read again, what was changed is found out, what is wrong is named with its line."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.raw_parameters import DriveIdentity
from hil.parameters.job import LARGEST_BYTES, backed_up_at, keep_set, require_size, set_files
from hil.parameters.set_file import (
    FORMAT,
    ParameterSet,
    SetEntry,
    object_address,
    object_key,
    read_set,
    render_set,
    write_set,
)

IDENTITY = DriveIdentity("canopen", {"vendor_id": 0x1234, "device": 'a "drive"'}, {"firmware": "1.2"}, {"serial": 7})
ENTRIES = (
    SetEntry("2210h:01", 1000, 1000, "U32", "", "Proportional gain"),
    SetEntry("2210h:02", -0.5, "000000bf", "F32", "1/s", "Stiffness"),
    SetEntry("2101h:00", 'µ, \\ and "quotes"\n', "b5", "STRING", "", "Comment", ("2210h:01",)),
    SetEntry("2300h:00", None, "00ff", "OCTETS"),
)
SET = ParameterSet("as commissioned", IDENTITY, ENTRIES)


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "set.toml"
    written = write_set(path, SET)
    found = read_set(path)
    assert found == written
    assert found.entries == ENTRIES
    assert found.identity == IDENTITY
    assert [entry.line for entry in found.entries] == [6, 7, 8, 9]


values = st.one_of(st.integers(-(2**63), 2**64 - 1), st.floats(allow_nan=False), st.text(max_size=20))


@settings(max_examples=20)
@given(
    st.lists(
        st.tuples(st.integers(0, 0xFFFF), st.integers(0, 0xFF), values),
        min_size=1,
        max_size=5,
        unique_by=lambda e: e[:2],
    )
)
def test_any_values_survive_the_file(
    tmp_path_factory: pytest.TempPathFactory, members: list[tuple[int, int, object]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.toml"
    entries = tuple(SetEntry(object_address(index, subindex), value) for index, subindex, value in members)  # type: ignore[arg-type]
    write_set(path, ParameterSet("any", None, entries))
    assert read_set(path).entries == entries


def test_numbers_that_are_none_survive_the_file(tmp_path: Path) -> None:
    path = tmp_path / "set.toml"
    entries = tuple(SetEntry(f"r{number}", value) for number, value in enumerate((math.inf, -math.inf, math.nan)))
    write_set(path, ParameterSet("odd", None, entries))
    plus, minus, none = (entry.value for entry in read_set(path).entries)
    assert (plus, minus) == (math.inf, -math.inf)
    assert isinstance(none, float)
    assert math.isnan(none)


def test_the_hash_is_of_what_an_identity_says_in_whatever_order() -> None:
    one = DriveIdentity("canopen", {"vendor_id": 1, "product_code": 2}, {"firmware": "1", "revision": 3})
    other = DriveIdentity("canopen", {"product_code": 2, "vendor_id": 1}, {"revision": 3, "firmware": "1"})
    assert replace(SET, identity=one).digest() == replace(SET, identity=other).digest()
    assert replace(SET, identity=one).digest() != SET.digest()


def test_comments_and_blanks_are_free_but_values_are_not(tmp_path: Path) -> None:
    path = tmp_path / "set.toml"
    write_set(path, SET)
    text = path.read_text(encoding="utf-8")
    path.write_text(f"# for the spare drive\n{text}", encoding="utf-8")
    assert read_set(path).entries == ENTRIES
    path.write_text(text.replace("value = 1000, raw = 1000", "value = 1001, raw = 1001"), encoding="utf-8")
    with pytest.raises(InputError, match=r"set.toml:3: was changed after it was written: its hash does not fit"):
        read_set(path)
    path.write_text(re.sub("hash.*\n", "", path.read_text(encoding="utf-8")), encoding="utf-8")
    assert read_set(path).entries[0].value == 1001


@pytest.mark.parametrize(
    ("entry", "edited"),
    [
        (SetEntry("2210h:01", 1000, 1000, "U32"), "1001"),
        (SetEntry("torque_limit", 250.0, 2500, "u16", "percent"), "260.0"),
        (SetEntry("2301h:00", "4142", "4142", "OCTET_STRING"), '"4143"'),
    ],
)
def test_a_value_edited_alone_is_refused_with_what_to_change_and_read_after_that(
    entry: SetEntry, edited: str, tmp_path: Path
) -> None:
    path = tmp_path / "set.toml"
    write_set(path, replace(SET, entries=(entry,)))
    text = re.sub(r"value = [^,]*,", f"value = {edited},", path.read_text(encoding="utf-8"))
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="remove this line, and `raw` from each parameter whose `value` you changed"):
        read_set(path)
    path.write_text(re.sub(r"(?m)^hash.*\n| raw = [^,]*,", "", text), encoding="utf-8")
    (found,) = read_set(path).entries
    assert (repr(found.value).replace("'", '"'), found.raw) == (edited, None)


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("{ index = 0x2210, subindex = 1 }", "2210h:01 has neither value nor raw"),
        ("{ index = 0x12345, value = 1 }", "index is 74565, expected 0x0000 to 0xFFFF"),
        ("{ index = 0x2210, value = true }", "value is True, expected a number or a text"),
        ('{ index = 0x2210, raw = "0g" }', "raw is '0g', expected a whole number or hexadecimal digits"),
        ("{ index = 0x2210, value = 1, vlaue = 2 }", "unknown key vlaue, the nearest known one is value"),
        ('{ register = "gain", index = 0x2210, value = 1 }', "index stands beside register gain"),
        ('{ register = "gain", subindex = 0, value = 1 }', "subindex stands beside register gain"),
        ("{ value = 1 }", "lacks index"),
        ('{ register = "2210h:01", value = 1 }', "which is an object: give index and subindex"),
        ("{ index = 0x2000, value = 1 }", "2000h:00 is there twice"),
        ("7", "is 7, expected a table"),
    ],
)
def test_a_wrong_entry_is_named_with_its_line(tmp_path: Path, line: str, what: str) -> None:
    path = tmp_path / "set.toml"
    path.write_text(
        f'format = "hil parameter set 1"\nname = "x"\nparameters = [\n  {{ index = 0x2000, value = 1 }},\n  {line},\n]\n'
    )
    with pytest.raises(InputError) as caught:
        read_set(path)
    assert what in str(caught.value)
    assert line == "7" or f"{path}:5: " in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "parameters = []", 'format = "hil parameter set 2"', "\0", "format = [", "name = 1"]
)
def test_another_file_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "set.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"set\.toml"):
        read_set(path)


def test_addresses() -> None:
    assert object_key("2210h:0A") == (0x2210, 10)
    assert object_key("stiffness") is None
    assert object_address(0x607D, 2) == "607D:02".replace(":", "h:")


def test_a_set_reads_well() -> None:
    assert (
        '  { index = 0x2210, subindex = 1, value = 1000, raw = 1000, type = "U32", name = "Proportional gain" },'
        in render_set(SET)
    )


# -- files of sets -------------------------------------------------------------------------------------------------
@pytest.fixture
def axis(tmp_path: Path) -> Any:
    home = tmp_path / "home"
    home.mkdir()
    (home / "x.toml").write_text('name = "X"\n')
    return cast(
        Any, SimpleNamespace(name="X", path=home / "x.toml", store=SimpleNamespace(directory=tmp_path / "kept"))
    )


def a_set(path: Path, value: int = 1) -> bytes:
    write_set(
        path, ParameterSet("gains", None, (SetEntry("6065h:00", value, None, "UNSIGNED32", "", "window"),), None, path)
    )
    return path.read_bytes()


def test_sets_are_known_by_suffix_and_toml_by_its_first_lines(axis: Any, tmp_path: Path) -> None:
    home = axis.path.parent
    a_set(home / "b.toml")
    for name in ("a.dcf", "C.DCF", ".hidden.dcf", "notes.txt", "late.toml"):
        (home / name).write_text("x")
    (home / "late.toml").write_bytes(b"#" * 4096 + FORMAT.encode())
    (home / "in_time.toml").write_bytes(b"#" * (4096 - len(FORMAT)) + FORMAT.encode())
    (home / "folder.dcf").mkdir()
    brought = tmp_path / "kept/parameters/sets"
    brought.mkdir(parents=True)
    (brought / "aa.dcf").write_text("x")
    assert [path.name for path in set_files(axis)] == ["C.DCF", "a.dcf", "aa.dcf", "b.toml", "in_time.toml"]


def test_an_upload_is_kept_once_and_never_replaced(axis: Any, tmp_path: Path) -> None:
    data, other = a_set(tmp_path / "one.toml"), a_set(tmp_path / "other.toml", 2)
    path = keep_set(axis, "some/folder/gains.toml", data)
    assert (path.name, path.read_bytes()) == ("gains.toml", data)
    assert set_files(axis) == (path,)
    assert keep_set(axis, "gains.toml", data) == path
    with pytest.raises(InputError, match="something else"):
        keep_set(axis, "gains.toml", other)
    assert path.read_bytes() == data
    assert keep_set(axis, "again.toml", other).read_bytes() == other


@pytest.mark.parametrize("name", ["gains.exe", "gains", ".toml", "bad|name.toml", "-x.toml", f"{'x' * 100}.toml"])
def test_a_name_that_is_none_of_a_set_is_refused(axis: Any, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="expected the name of a set"):
        keep_set(axis, name, a_set(tmp_path / "one.toml"))
    assert set_files(axis) == ()


def test_nothing_is_left_of_an_upload_that_is_no_set(axis: Any) -> None:
    with pytest.raises(InputError):
        keep_set(axis, "gains.toml", b"no set = [")
    with pytest.raises(InputError, match="at most 2000000"):
        keep_set(axis, "gains.toml", b"#" * (LARGEST_BYTES + 1))
    assert not [path for path in axis.store.directory.rglob("*") if path.is_file()]


def test_the_size_may_be_the_largest_and_no_more() -> None:
    require_size("a/b.toml", 2_000_000)
    with pytest.raises(InputError, match=r"^b\.toml has 2000001 bytes"):
        require_size("a/b.toml", 2_000_001)


def test_a_backup_says_in_its_name_when_it_was_made(axis: Any) -> None:
    found = backed_up_at(axis, Path("X-20260102-030405.params.toml"))
    assert found is not None
    assert found.tzinfo is not None
    assert found.replace(tzinfo=None) == datetime(2026, 1, 2, 3, 4, 5)
    for name in (
        "Y-20260102-030405.params.toml",
        "X-20260102-030405.toml",
        "X-late.params.toml",
        "20260102-030405.params.toml",
    ):
        assert backed_up_at(axis, Path(name)) is None
