"""Registers in counts, revolutions and rpm as motor counts, and back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.modbus.codec import Layout, RegisterType
from drivers.modbus.drive_values import from_counts, to_counts, to_percent
from drivers.modbus.plan import AddressSpace, Span
from drivers.modbus.register_map import Register


def register(unit: str, scale: float = 1.0, kind: RegisterType = RegisterType.I32) -> Register:
    return Register("it", AddressSpace.HOLDING, Span(0, kind.words), Layout(kind), scale=scale, unit=unit)


@pytest.mark.parametrize(
    ("unit", "scale", "raw", "counts"),
    [
        ("counts", 1.0, -123_456_789, -123_456_789),
        ("counts", 4.0, 25, 100),
        ("rev", 1e-4, 15_000, 150_000),
        ("counts/s", 1.0, 7, 7),
        ("rpm", 0.1, 600, 100_000),  # 60 rpm is one revolution a second
        ("rev/s", 0.01, 50, 50_000),
        ("counts/s2", 1.0, 9, 9),
        ("rpm/s", 1.0, 30, 50_000),
        ("rev/s2", 1.0, 2, 200_000),
    ],
)
def test_worked_examples(unit: str, scale: float, raw: int, counts: float) -> None:
    assert to_counts(raw, register(unit, scale), 100_000) == pytest.approx(counts, rel=1e-12)
    assert from_counts(counts, register(unit, scale), 100_000) == raw


@given(counts=st.integers(-(2**31), 2**31 - 1))
def test_counts_pass_through_exactly(counts: int) -> None:
    there = from_counts(counts, register("counts"), 1_000_000)
    assert there == counts
    assert to_counts(there, register("counts"), 1_000_000) == counts


def test_torque() -> None:
    assert to_percent(123, register("permille", kind=RegisterType.I16)) == pytest.approx(12.3)
    assert to_percent(-1000, register("percent", 0.1, RegisterType.I16)) == pytest.approx(-100.0)


def test_units_that_are_none() -> None:
    for unit in ("mm", ""):
        with pytest.raises(InputError, match="expected counts or revolutions"):
            to_counts(1, register(unit), 100)
    with pytest.raises(InputError, match="expected percent or permille"):
        to_percent(1, register("Nm"))
    with pytest.raises(InputError, match="does not fit a i32"):
        from_counts(2**31, register("counts"), 100)
