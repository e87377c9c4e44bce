"""Registers <-> values: vectors written out by hand, round trips, refusals, and finding an order from a known value."""

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.modbus.codec import Layout, Order, RegisterType, decode, encode, probe_order

BIG, LITTLE = Order.BIG, Order.LITTLE
ORDERS = [(BIG, BIG), (LITTLE, BIG), (BIG, LITTLE), (LITTLE, LITTLE)]
INTEGERS = [kind for kind in RegisterType if kind.is_integer]

# 0x12345678 in the four layouts manuals call ABCD, CDAB, BADC and DCBA
ABCD = {
    (BIG, BIG): (0x1234, 0x5678),
    (LITTLE, BIG): (0x5678, 0x1234),
    (BIG, LITTLE): (0x3412, 0x7856),
    (LITTLE, LITTLE): (0x7856, 0x3412),
}


@pytest.mark.parametrize("orders", ORDERS)
def test_the_four_layouts_of_a_32_bit_value(orders: tuple[Order, Order]) -> None:
    layout = Layout(RegisterType.U32, *orders)
    assert encode(0x12345678, layout) == ABCD[orders]
    assert decode(ABCD[orders], layout) == 0x12345678


@pytest.mark.parametrize(
    ("kind", "value", "registers"),
    [
        (RegisterType.I16, -2, (0xFFFE,)),
        (RegisterType.I32, -2, (0xFFFF, 0xFFFE)),
        (RegisterType.U64, 0x0123456789ABCDEF, (0x0123, 0x4567, 0x89AB, 0xCDEF)),
        (RegisterType.I64, -1, (0xFFFF,) * 4),
        (RegisterType.F32, 1.0, (0x3F80, 0x0000)),  # IEEE 754: 3F800000
        (RegisterType.F32, -118.625, (0xC2ED, 0x4000)),  # C2ED4000
        (RegisterType.F64, 1.0, (0x3FF0, 0, 0, 0)),
        (RegisterType.TEN_THOUSANDS, 125_000, (12, 5000)),  # 12.5 turns of 10000, as a maker's parameter list writes it
        (RegisterType.TEN_THOUSANDS, -5, (0, 0xFFFB)),
        (RegisterType.TEN_THOUSANDS, -123_456, (0x10000 - 12, 0x10000 - 3456)),
        (RegisterType.BIT, 1, (1,)),
        (RegisterType.BITS, 0x8001, (0x8001,)),
    ],
)
def test_values_written_out_by_hand(kind: RegisterType, value: float, registers: tuple[int, ...]) -> None:
    assert encode(value, Layout(kind)) == registers
    assert decode(registers, Layout(kind)) == value


def test_ten_thousands_whose_rest_has_another_sign_are_read() -> None:
    assert decode((0xFFFF, 9995), Layout(RegisterType.TEN_THOUSANDS)) == -5
    assert decode((5000, 12), Layout(RegisterType.TEN_THOUSANDS, LITTLE)) == 125_000
    with pytest.raises(InputError, match="expected a whole number -99999999 to 99999999"):
        encode(100_000_000, Layout(RegisterType.TEN_THOUSANDS))


def test_a_string_is_padded_and_its_bytes_swapped_but_its_words_never() -> None:
    assert encode("AB1", Layout(RegisterType.STRING, length=3)) == (0x4142, 0x3100, 0)
    swapped = Layout(RegisterType.STRING, LITTLE, LITTLE, length=2)
    assert encode("AB1", swapped) == (0x4241, 0x0031)
    assert decode((0x4241, 0x0031), swapped) == "AB1"


@given(data=st.data())
def test_round_trip_of_every_type_and_order(data: st.DataObject) -> None:
    kind = data.draw(st.sampled_from([each for each in RegisterType if each is not RegisterType.STRING]))
    layout = Layout(kind, *data.draw(st.sampled_from(ORDERS)))
    if kind.is_integer:
        value: float = data.draw(st.integers(*kind.bounds))
    else:
        value = data.draw(st.floats(width=32 if kind is RegisterType.F32 else 64, allow_nan=False))
    registers = encode(value, layout)
    assert len(registers) == layout.words
    assert all(0 <= word <= 0xFFFF for word in registers)
    assert decode(registers, layout) == value


@given(text=st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=20), orders=st.sampled_from(ORDERS))
def test_round_trip_of_text(text: str, orders: tuple[Order, Order]) -> None:
    layout = Layout(RegisterType.STRING, *orders, length=10)
    assert decode(encode(text, layout), layout) == text


@given(registers=st.lists(st.integers(0, 0xFFFF), min_size=4, max_size=4), orders=st.sampled_from(ORDERS))
def test_the_orders_agree_with_shuffling_the_bytes(registers: list[int], orders: tuple[Order, Order]) -> None:
    words = registers if orders[0] is BIG else registers[::-1]
    wire = b"".join(struct.pack(">H" if orders[1] is BIG else "<H", word) for word in words)
    assert decode(registers, Layout(RegisterType.U64, *orders)) == int.from_bytes(wire, "big")


@pytest.mark.parametrize("kind", INTEGERS)
def test_what_does_not_fit_is_refused_and_never_wrapped(kind: RegisterType) -> None:
    low, high = kind.bounds
    for value in (low - 1, high + 1, 0.5, math.nan, math.inf):
        with pytest.raises(InputError, match="does not fit"):
            encode(value, Layout(kind))


def test_refusals_of_text_floats_and_counts() -> None:
    with pytest.raises(InputError, match="does not fit a f32"):
        encode(1e300, Layout(RegisterType.F32))
    with pytest.raises(InputError, match="expected a number"):
        encode("7", Layout(RegisterType.U16))
    with pytest.raises(InputError, match="expected at most 4"):
        encode("ABCDE", Layout(RegisterType.STRING, length=2))
    with pytest.raises(InputError, match="ASCII"):
        encode("µm", Layout(RegisterType.STRING, length=2))
    with pytest.raises(InputError, match="expected 2"):
        decode((1,), Layout(RegisterType.U32))
    with pytest.raises(InputError, match="0 registers"):
        Layout(RegisterType.STRING)


@given(data=st.data())
def test_probing_finds_the_true_order_among_its_matches(data: st.DataObject) -> None:
    kinds = [each for each in RegisterType if each not in (RegisterType.BIT, RegisterType.BITS, RegisterType.STRING)]
    kind = data.draw(st.sampled_from(kinds))
    layout = Layout(kind, *data.draw(st.sampled_from(ORDERS)))
    if kind.is_integer:
        value: float = data.draw(st.integers(*kind.bounds))
    else:
        value = data.draw(st.floats(-1e6, 1e6, width=32))
    matches = probe_order(encode(value, layout), value)
    # a single register has no word order: reported once, as big
    true = Layout(kind, layout.word_order if kind.words > 1 else BIG, layout.byte_order)
    assert true in [match.layout for match in matches]
    for match in matches:
        assert match.value == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("orders", ORDERS)
def test_a_position_with_four_different_bytes_has_one_answer_per_signedness(orders: tuple[Order, Order]) -> None:
    registers = encode(123_456_789, Layout(RegisterType.I32, *orders))
    matches = probe_order(registers, 123_456_789)
    assert {match.layout for match in matches} == {
        Layout(RegisterType.I32, *orders),
        Layout(RegisterType.U32, *orders),
    }
    assert probe_order(registers, -123_456_789) == ()


def test_probing_shows_an_address_base_that_is_off_by_one() -> None:
    neighbours = (7, *encode(-123_456_789, Layout(RegisterType.I32, LITTLE, BIG)), 9)
    (match,) = probe_order(neighbours, -123_456_789)
    assert (match.offset, match.layout) == (1, Layout(RegisterType.I32, LITTLE, BIG))


def test_probing_with_scale_and_an_axis_not_quite_still() -> None:
    registers = encode(-1_234_567, Layout(RegisterType.I32, LITTLE, BIG))
    (match,) = probe_order(registers, -123.4, scale=1e-4, tolerance=0.1)
    assert match.layout == Layout(RegisterType.I32, LITTLE, BIG)
    assert match.value == pytest.approx(-123.4567)


def test_probing_takes_a_float_typed_in_decimals() -> None:
    registers = encode(12.34, Layout(RegisterType.F32, BIG, LITTLE))
    (match,) = probe_order(registers, 12.34)
    assert match.layout == Layout(RegisterType.F32, BIG, LITTLE)


@pytest.mark.parametrize(("value", "keywords"), [(math.nan, {}), (1.0, {"scale": 0.0}), (1.0, {"tolerance": -1.0})])
def test_probing_refuses_nonsense(value: float, keywords: dict[str, float]) -> None:
    with pytest.raises(InputError):
        probe_order((1, 2), value, **keywords)
