"""Objections and notes before a download, by hand: values that contradict their raw form, a reversal that would be corrected twice,
and units that no longer hold."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.errors import InputError
from drivers.parameters import ParameterKind
from hil.correction.store import BoundTables
from hil.parameters.job import backlash_addresses
from hil.parameters.preflight import Objection, Wanted, data_of, notes_of_units, objections_to_reversal
from hil.parameters.set_file import SetEntry


def parameter(address: str, kind: ParameterKind = ParameterKind.NUMBER, type_: str = "REAL64") -> Any:
    return SimpleNamespace(address=address, type=type_, info=SimpleNamespace(name=f"name of {address}", kind=kind))


def packed(value: float) -> bytes:
    return struct.pack("<d", value)


class Doubles:
    """A drive whose parameters are doubles without limits, equal when their bytes are; text has more than eight bytes."""

    def decode(self, _parameter: object, data: bytes) -> float | str:
        return struct.unpack("<d", data)[0] if len(data) == 8 else data.decode()

    def encode(self, _parameter: object, value: float | str) -> bytes:
        return value.encode() if isinstance(value, str) else packed(value)

    def same(self, _parameter: object, one: bytes, other: bytes) -> bool:
        return one == other

    def outside(self, _parameter: object, _value: float | str) -> None:
        return None

    def from_raw(self, _parameter: object, raw: str) -> bytes:
        return bytes.fromhex(raw)


DRIVE = cast(Any, Doubles())


def entry(value: Any, raw: bytes | None) -> SetEntry:
    return SetEntry("a", value, None if raw is None else raw.hex(), "REAL64", "", "name")


@pytest.mark.parametrize("value", [100.0, -100.0, 0.0])
def test_a_value_agrees_with_its_raw_form_to_one_in_a_million(value: float) -> None:
    for raw in (value, value * (1 + 0.9e-6), value * (1 - 0.9e-6)):
        assert data_of(DRIVE, parameter("a"), entry(value, packed(raw))) == packed(raw)
    for raw in (value + 1.1e-4, value - 1.1e-4, -value - 50.0):
        with pytest.raises(InputError, match="do not agree"):
            data_of(DRIVE, parameter("a"), entry(value, packed(raw)))


@pytest.mark.parametrize("value", [1000.0, -1000.0])
def test_the_tolerance_grows_with_the_larger_of_both(value: float) -> None:
    with pytest.raises(InputError, match="do not agree"):
        data_of(DRIVE, parameter("a"), entry(value, packed(1e-9)))
    assert data_of(DRIVE, parameter("a"), entry(value, packed(value + 0.0009)))


def test_text_beside_a_number_never_agrees() -> None:
    with pytest.raises(InputError, match="do not agree"):
        data_of(DRIVE, parameter("a"), entry(1.0, b"no number"))
    with pytest.raises(InputError, match="do not agree"):
        data_of(DRIVE, parameter("a"), entry("some text", packed(1.0)))


def test_bytes_are_hexadecimal_digits_and_text_is_not() -> None:
    assert data_of(DRIVE, parameter("a", ParameterKind.BYTES), entry("0aff", None)) == b"\x0a\xff"
    assert data_of(DRIVE, parameter("a", ParameterKind.NUMBER), entry("0aff", None)) == b"0aff"
    with pytest.raises(InputError, match="hexadecimal"):
        data_of(DRIVE, parameter("a", ParameterKind.BYTES), entry("zz", None))


# -- stored tables -------------------------------------------------------------------------------------------------------
def tables(
    *, corrects: bool | None = True, backlash: dict[str, float] | None = None, units: dict[str, float] | None = None
) -> Any:
    made = None if backlash is None and units is None else SimpleNamespace(backlash=backlash or {}, units=units or {})
    return cast(BoundTables, SimpleNamespace(axis="X", corrects_reversal=corrects, made_with=made))


def wanted(address: str, value: float | str) -> Wanted:
    return Wanted(parameter(address), packed(value) if isinstance(value, float) else value.encode())


def objects(found: list[Objection]) -> list[str]:
    return [one.address for one in found]


@pytest.mark.parametrize("corrects", [True, None])
def test_another_amount_than_the_tables_were_made_with_is_refused(corrects: bool | None) -> None:
    made = tables(corrects=corrects, backlash={"bl": 5.0})
    (found,) = objections_to_reversal(DRIVE, made, [], [wanted("bl", 6.0), wanted("other", 1.0)], {"bl": packed(6.0)})
    assert (found.address, found.name) == ("bl", "name of bl")
    assert "would be 6, the stored tables of axis X were made with 5 " in found.why
    assert objections_to_reversal(DRIVE, made, [], [wanted("bl", 5.0)], {"bl": packed(6.0)}) == []


@pytest.mark.parametrize(
    ("parameter_", "acceleration", "addresses"),
    [
        ("2201h", None, ("2201h:00",)),
        ("2201h:01", "202Ah", ("2201h:01", "202Ah:00")),
        ("gain", None, ("gain",)),
        (None, None, ()),
    ],
)
def test_the_axis_files_backlash_is_named_as_sets_name_it(
    parameter_: str | None, acceleration: str | None, addresses: tuple[str, ...]
) -> None:
    axis = SimpleNamespace(backlash=SimpleNamespace(parameter=parameter_, acceleration=acceleration))
    assert backlash_addresses(cast(Any, axis)) == addresses
    assert backlash_addresses(cast(Any, SimpleNamespace(backlash=None))) == ()


def test_tables_that_leave_the_reversal_alone_object_to_nothing() -> None:
    assert (
        objections_to_reversal(DRIVE, tables(corrects=False, backlash={"bl": 5.0}), ["bl"], [wanted("bl", 6.0)], {})
        == []
    )


def test_where_the_tables_state_no_amount_what_the_drive_holds_counts() -> None:
    for made in (tables(), tables(backlash={"elsewhere": 1.0})):
        present = {"bl": packed(5.0), "other": packed(5.0)}
        found = objections_to_reversal(DRIVE, made, ["bl"], [wanted("bl", 6.0), wanted("other", 6.0)], present)
        assert objects(found) == ["bl"]
        assert objections_to_reversal(DRIVE, made, ["bl"], [wanted("bl", 5.0)], present) == []
        assert objections_to_reversal(DRIVE, made, ["bl"], [wanted("bl", 6.0)], {}) == []


def test_a_text_is_no_amount() -> None:
    made = tables(backlash={"bl": 5.0})
    assert objections_to_reversal(DRIVE, made, [], [wanted("bl", "what is not a number")], {}) == []
    assert objections_to_reversal(DRIVE, tables(), ["bl"], [wanted("bl", 6.0)], {"bl": b"what is not a number"}) == []


def test_units_that_the_tables_were_not_made_with_are_told() -> None:
    made = tables(units={"gear": 2.0})
    (note,) = notes_of_units(DRIVE, made, [wanted("gear", 3.0), wanted("other", 3.0)])
    assert note.startswith("gear name of gear: the stored tables of axis X were made with 2 and are refused with 3")
    assert notes_of_units(DRIVE, made, [wanted("gear", 2.0)]) == []
    assert notes_of_units(DRIVE, made, [wanted("gear", "what is not a number")]) == []
    assert notes_of_units(DRIVE, tables(), [wanted("gear", 3.0)]) == []
