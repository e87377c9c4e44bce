"""µMD lines as the published firmware sends them, written out by hand, against the decoder."""

import pytest

from drivers.instruments.lines import BadLine
from drivers.instruments.umd import (
    SLOW_SCALE,
    SampleState,
    UmdDecoder,
    UmdSample,
    lost_between,
    phase_fraction,
)


def events(*chunks: bytes) -> list[UmdSample | BadLine]:
    """Of these bytes behind a line end, at which a decoder begins."""
    decoder = UmdDecoder()
    return [event for chunk in (b"\n", *chunks) for event in decoder.feed(chunk)]


def one(line: bytes) -> UmdSample:
    found = events(line + b"\r\n")
    assert len(found) == 1
    assert isinstance(found[0], UmdSample)
    return found[0]


def test_a_line_of_one_axis() -> None:
    sample = one(b"3276 3281 -15801 5 77 4711 3 2150")
    assert sample == UmdSample(3276, 3281, -15801, 5, 77, 4711, 3, 2150)
    axis = sample.axis(1)
    assert axis is not None
    assert axis.state is SampleState.GOOD
    assert axis.units == -15801 + 77 / 256
    assert sample.axis(2) is None


def test_a_line_of_three_axes() -> None:
    sample = one(b"3276 3276 10 0 0 9 5 101325 3277 20 1 64 0 30 0 384")
    second, third = sample.axis(2), sample.axis(3)
    assert second is not None
    assert third is not None
    assert (second.state, second.units) == (SampleState.GOOD, 20.25)
    assert (third.state, third.ref, third.meas) == (SampleState.BEAM_LOST, 3276, 0)
    assert third.units == 30 - 0.5
    assert sample.axis(4) is None


@pytest.mark.parametrize(
    ("phase", "fraction"),
    [
        (0, 0.0),
        (1, 1 / 256),
        (255, 255 / 256),
        (0x100, -1.0),
        (0x1FF, -1 / 256),
        (0x180, -0.5),
        (-1, -1 / 256),
        (-128, -0.5),
    ],
)
def test_phase_is_a_fraction_of_a_unit_with_bit_8_as_its_sign(phase: int, fraction: float) -> None:
    assert phase_fraction(phase) == fraction


@pytest.mark.parametrize(
    ("line", "state"),
    [
        (b"0 0 5 0 0 1 0 0", SampleState.HEAD_ERROR),
        (b"0 3276 5 0 0 1 0 0", SampleState.HEAD_ERROR),
        (b"3276 0 5 0 0 1 0 0", SampleState.BEAM_LOST),
        (b"3276 6552 5 0 0 1 0 0", SampleState.GOOD),
        (b"3276 6553 5 0 0 1 0 0", SampleState.OVERSPEED),
        (b"3276 3276 5 0 1024 1 0 0", SampleState.HEAD_ERROR),  # 0x400: no second edge of REF
        (b"3276 3276 5 0 2048 1 0 0", SampleState.BEAM_LOST),  # 0x800: no edge of MEAS
        (b"3276 3276 5 0 16384 1 0 0", SampleState.BEAM_LOST),  # 0x4000: no edge of MEAS in the averages
        (b"3276 3276 5 0 -512 1 0 0", SampleState.GOOD),  # a negative fraction, not error bits
    ],
)
def test_states_of_the_signal(line: bytes, state: SampleState) -> None:
    axis = one(line).axis(1)
    assert axis is not None
    assert axis.state is state


def test_slow_values_and_their_scales() -> None:
    got = [one(b"1 1 0 0 0 1 %d %d" % pair) for pair in ((3, 2150), (4, 2233), (5, 101325), (6, 505), (8, 61035))]
    values = [sample.slow_data * SLOW_SCALE[sample.slow_code] for sample in got]
    assert values == pytest.approx([21.50, 22.33, 1013.25, 50.5, 610.35])


def test_lines_in_pieces_and_other_line_ends() -> None:
    whole = b"1 1 7 0 0 1 0 0\r\n1 1 8 0 0 2 0 0\n1 1 9 0 0 3 0 0\r1 1 10 0 0 4 0 0\r\n"
    expected = events(whole)
    assert [sample.displacement for sample in expected if isinstance(sample, UmdSample)] == [7, 8, 9, 10]
    for cut in range(len(whole) + 1):
        assert events(whole[:cut], whole[cut:]) == expected
    assert events(*(whole[i : i + 1] for i in range(len(whole)))) == expected


def test_joining_in_mid_line_never_takes_a_cut_number_for_a_whole_one() -> None:
    decoder = UmdDecoder()
    found = decoder.feed(b"6 3276 5 0 0 1 0 0\r\n3276 3276 6 0 0 2 0 0\r\n")
    assert [type(event) for event in found] == [BadLine, UmdSample]


@pytest.mark.parametrize(
    "raw",
    [
        b"3276 3276 5 0 0 1 0",
        b"3276 3276 5 0 0 1 0 0 0",
        b"3276 3276 5 0 0 1 0 x",
        b"3276 3276 5 0 0 1 0 1_0",
        b"3276 3276 +5 0 0 1 0 0",
        b"3276 3276 5- 0 0 1 0 0",
        b"3276 3276 5 0 0 1 0 \xff",
        b"-1 3276 5 0 0 1 0 0",
        b"3276 3276 99999999999999999999 0 0 1 0 0",
        "3276 3276 ٣ 0 0 1 0 0".encode(),
    ],
)
def test_what_is_no_sample_is_reported_with_its_bytes(raw: bytes) -> None:
    found = events(raw + b"\r\n", b"1 1 7 0 0 1 0 0\r\n")
    assert isinstance(found[0], BadLine)
    assert found[0].raw == raw
    assert found[0].reason
    assert found[1] == UmdSample(1, 1, 7, 0, 0, 1, 0, 0)


def test_memory_is_bounded_and_the_stream_is_found_again() -> None:
    decoder = UmdDecoder()
    found = decoder.feed(b"\n")
    for _ in range(1000):
        found += decoder.feed(b"7" * 1000)
    assert len(found) == 1
    found = decoder.feed(b"77\r\n1 1 7 0 0 1 0 0\r\n")
    assert found == [UmdSample(1, 1, 7, 0, 0, 1, 0, 0)]


@pytest.mark.parametrize(
    ("before", "now", "lost"),
    [
        (5, 6, 0),
        (5, 9, 3),
        (2**32 - 1, 0, 0),
        (2**31 - 1, 2**31, 0),
        (5, 5, None),
        (5000, 1, None),
        (2**32 + 3, 2**32 + 5, 1),
    ],
)
def test_gaps_in_the_sequence(before: int, now: int, lost: int | None) -> None:
    assert lost_between(before, now) == lost
