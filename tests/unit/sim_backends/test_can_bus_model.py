"""Frame lengths on the wire: against the published ranges, a bit-by-bit transmitter, and a frame worked out by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.can_bus_model import crc15, frame_bits, stuff_bits, wire_time_ns


@given(identifier=st.integers(0, 0x7FF), data=st.binary(max_size=8))
def test_every_frame_lies_within_the_published_range(identifier: int, data: bytes) -> None:
    """47 bits and the data, and at most one stuffed bit for every four of those that are stuffed."""
    least, stuffed = 47 + 8 * len(data), 34 + 8 * len(data)
    assert least <= frame_bits(identifier, data) <= least + (stuffed - 1) // 4


def test_the_worst_case_is_reached() -> None:
    """Alternating groups of four after a first five stuff as densely as can be: (n - 1) // 4 bits."""
    bits = [0] * 5 + [1, 1, 1, 1, 0, 0, 0, 0] * 12
    assert stuff_bits(bits) == (len(bits) - 1) // 4


@pytest.mark.parametrize(
    ("bits", "inserted"),
    [
        ([0, 0, 0, 0], 0),
        ([0, 0, 0, 0, 0], 1),
        ([0, 0, 0, 0, 0, 0, 0, 0, 0], 1),  # 0 0 0 0 0 [1] 0 0 0 0
        ([0, 0, 0, 0, 0, 0, 0, 0, 0, 0], 2),
        ([0, 0, 0, 0, 0, 1, 1, 1, 1], 2),  # the inserted 1 is the first of five
        ([1, 0] * 20, 0),
    ],
)
def test_stuffing_counts_its_own_bits(bits: list[int], inserted: int) -> None:
    assert stuff_bits(bits) == inserted


def test_the_nmt_frame_by_hand() -> None:
    """SOF 0, id 00000000000, RTR 0 IDE 0 r0 0, DLC 0000: 19 zeros, CRC of zeros is 0: 34 zeros in a row.

    A 1 goes in after each five zeros: after bit 5, 10, … 30: six of them (the last group has four). 34 + 6 + 10 + 3 = 53.
    """
    assert frame_bits(0x000, b"") == 53


def test_the_sync_frame_by_hand() -> None:
    """080h: 0 00010000000 000 0000 then its CRC; the polynomial divided out below once more, on integers."""
    head = int("0" + f"{0x080:011b}" + "000" + "0000", 2)
    remainder = head << 15
    for place in range(19 + 14, 14, -1):
        if remainder >> place & 1:
            remainder ^= 0b1100_0101_1001_1001 << (place - 15)
    bits = [int(digit) for digit in f"{head:019b}"]
    assert crc15(bits) == remainder


def test_the_crc_divides_out() -> None:
    """A frame with its CRC appended leaves no remainder."""
    bits = [0, 1, 1, 0, 1, 0, 0, 1, 1, 1, 0, 0, 1, 0, 1, 1]
    crc = crc15(bits)
    assert crc15(bits + [crc >> place & 1 for place in range(14, -1, -1)]) == 0


def test_wire_time_at_one_megabit() -> None:
    assert wire_time_ns(0x000, b"", 1_000_000) == 53_000
    assert wire_time_ns(0x000, b"", 125_000) == 424_000
