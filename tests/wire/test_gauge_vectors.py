"""Lines of displays and gauges as their manuals print them, written out by hand, against the decoders."""

from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.instruments.ascii_values import AsciiDecoder, AsciiSettings
from drivers.instruments.nd2xx import ASK_COUNT, ASK_DISPLAYED, Nd2xxDecoder
from drivers.instruments.values import BadLine, Fault, Value, ValueProtocol

MITUTOYO = AsciiSettings(pattern="mitutoyo")


def nd(*chunks: bytes, count_mm: float | None = None) -> list[object]:
    decoder = Nd2xxDecoder(count_mm)
    return [event for chunk in chunks for event in decoder.feed(chunk)]


ASKED = AsciiSettings(request=b"?")


def text(*chunks: bytes, using: AsciiSettings = ASKED) -> list[object]:
    decoder = AsciiDecoder(using)
    return [event for chunk in chunks for event in decoder.feed(chunk)]


def test_requests_are_the_manuals() -> None:
    assert bytes([0x02]) == ASK_DISPLAYED
    assert bytes([0x1B, 0x41, 0x30, 0x32, 0x30, 0x30, 0x0D]) == ASK_COUNT
    assert Nd2xxDecoder().request == ASK_DISPLAYED
    assert Nd2xxDecoder(0.0001).request == ASK_COUNT


@pytest.mark.parametrize(
    ("line", "position_mm"),
    [
        (b"-      5.23  =A\r\n", -5.23),  # the manual's own: -5.23 mm, within the limits, actual value of a series
        (b"+   12.3456    \r\n", 12.3456),
        (b"-    .00050    \r\n", -0.0005),
        (b'+   1.00000 "  \r\n', 25.4),
        (b"+         0    \r\n", 0.0),
    ],
)
def test_what_an_nd_displays(line: bytes, position_mm: float) -> None:
    assert nd(line) == [Value(pytest.approx(position_mm))]
    for cut in range(len(line)):
        assert nd(line[:cut], line[cut:]) == [Value(pytest.approx(position_mm))]


def test_the_count_of_an_nd_needs_its_step() -> None:
    assert nd(b"\x02+123456789\r\n", count_mm=0.0001) == [Value(pytest.approx(12345.6789))]
    assert nd(b"\x02-000000050\r\n", count_mm=0.00005) == [Value(pytest.approx(-0.0025))]
    assert [type(event) for event in nd(b"\x02+123456789\r\n")] == [BadLine]


def test_what_an_nd_cannot_tell_is_a_fault() -> None:
    assert [type(event) for event in nd(b"-     5.23 ?  \r\n", b"+   12.3456 ?  \r\n")] == [BadLine, Fault]
    assert nd(b"\x15") == [Fault("the display does not understand the request (NAK)")]
    assert nd(b"\x02FORMAT.ERR.  \r\n") == [Fault("the display says 'FORMAT.ERR.'")]
    assert nd(b"\x06") == []


@pytest.mark.parametrize(
    "line",
    [
        b"-      5.23  =\r\n",  # cut at its end
        b"     5.23  =A\r\n",  # and at its beginning
        b"-      5.2.  =A\r\n",
        b"-      5 23  =A\r\n",
        b"-            =A\r\n",
        b"\x02+12345678\r\n",
        b"\x02+12\x063456789\r\n",  # a control character in the middle
        b"\xff\xff\r\n",
    ],
)
def test_what_is_no_reply_of_an_nd_is_never_a_value(line: bytes) -> None:
    found = nd(line, count_mm=0.001)
    assert found
    assert not any(isinstance(event, Value) for event in found)
    assert nd(line, b"+   12.3456    \r\n", count_mm=0.001)[-1] == Value(12.3456)


@pytest.mark.parametrize(
    ("line", "value"),
    [
        (b"01A+0000.123\r", 0.123),
        (b"01A-0000.125\r", -0.125),
        (b"02A+00.12345\r", 0.12345),
        (b"01A+000.1234\r", 0.1234),
    ],
)
def test_mitutoyo_lines(line: bytes, value: float) -> None:
    assert text(b"\r", line, using=MITUTOYO) == [Value(pytest.approx(value))]
    inches = AsciiSettings(pattern="mitutoyo", unit="in")
    assert text(b"\r", line, using=inches) == [Value(pytest.approx(25.4 * value))]


@pytest.mark.parametrize("line", [b"01A+0000.12\r", b"1A+0000.123\r", b"01A+0000.1234\r", b"01A+0000123\r", b"911\r"])
def test_a_mitutoyo_line_that_lost_a_character_is_no_value(line: bytes) -> None:
    assert [type(event) for event in text(b"\r", line, using=MITUTOYO)] == [BadLine]


def test_numbers_with_their_units() -> None:
    lines = b"12.5\r\n -3.25 um\n+ 0.5 in\r1.25mm\r\n7\xb5m\n7\xc2\xb5m\n"
    values = [12.5, -0.00325, 12.7, 1.25, 0.007, 0.007]
    assert text(lines) == [Value(pytest.approx(value)) for value in values]
    assert text(b"12.5\n", using=AsciiSettings(request=b"?", unit="um")) == [Value(pytest.approx(0.0125))]


CDI = AsciiSettings(pattern=r"(?P<value>[+-][ \d.]{8}) ,(?P<unit>[A-Z]{2})", request=b"R\r")
PROSCALE = AsciiSettings(pattern=r"(?P<value>-?\d+\.\d+) (?P<unit>mm|in)", request=b"R\r")


@pytest.mark.parametrize(
    ("line", "using", "value"),
    [
        (b"+   1.250 ,MM\r\n", CDI, 1.25),  # "USB and RS232 communication protocol" of the maker's indicators
        (b"-   0.050 ,IN\r\n", CDI, -1.27),
        (b"28.35 MM\r\n", PROSCALE, 28.35),  # manual of the receiver: "5.637 IN", "28.35 MM"
        (b"5.637 IN\r\n", PROSCALE, 143.1798),
        (b"1.5 Mm\r\n", ASKED, 1.5),
        (b"1.5 INCH\r\n", ASKED, 38.1),
        (b"1500 UM\r\n", ASKED, 1.5),
        ("1500 \N{MICRO SIGN}m\r\n".encode(), ASKED, 1.5),
        ("1500 \N{GREEK SMALL LETTER MU}M\r\n".encode(), ASKED, 1.5),
        ("1500 \N{GREEK CAPITAL LETTER MU}M\r\n".encode(), ASKED, 1.5),
        ("1500 \N{MICRO SIGN}m\r\n".encode("latin-1"), ASKED, 1.5),
        (b"2\r\n", AsciiSettings(unit="IN", request=b"?"), 50.8),
    ],
)
def test_a_unit_is_read_in_capitals_and_small_letters(line: bytes, using: AsciiSettings, value: float) -> None:
    (found,) = text(line, using=using)
    assert isinstance(found, Value)
    assert found.position_mm == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize("unit", [b"V", b"M", b"MIN", b"KG"])
def test_a_unit_that_is_no_known_length_is_no_value(unit: bytes) -> None:
    any_unit = AsciiSettings(pattern=r"(?P<value>\d+) (?P<unit>\w+)", request=b"?")
    assert isinstance(text(b"28 " + unit + b"\r\n", using=any_unit)[0], BadLine)


def test_a_pattern_of_ones_own() -> None:
    own = AsciiSettings(pattern=r"P=(?P<value>-?\d+) (?P<unit>\w+);S\d", fault=r"E\d\d", request=b"R\r")
    assert text(b"P=-250 um;S1\r\nE17\r\nP=1 km;S1\r\nP=250\r\n", using=own)[:2] == [
        Value(-0.25),
        Fault("the instrument says 'E17'"),
    ]
    assert [type(event) for event in text(b"P=1 km;S1\r\nP=250\r\n", using=own)] == [BadLine, BadLine]


def test_decimals_tell_a_cut_number_from_a_whole_one() -> None:
    using = AsciiSettings(decimals=3, request=b"?")
    assert [type(event) for event in text(b"1.234\n1.23\n1.\n1\n1.2345\n", using=using)] == [Value, *[BadLine] * 4]


def test_a_stream_is_believed_from_its_first_whole_line_on() -> None:
    assert [type(event) for event in text(b"3.456\r\n123.456\r\n", using=AsciiSettings())] == [BadLine, Value]
    assert text(b"3.456\r\n") == [Value(3.456)]  # of one that was asked, every line is whole


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"pattern": "("}, "no regular expression"),
        ({"pattern": r"(\d+)"}, "no group"),
        ({"fault": "["}, "no regular expression"),
        ({"unit": "furlong"}, "unit is 'furlong'"),
    ],
)
def test_settings_that_cannot_be_are_refused(wrong: dict[str, str], says: str) -> None:
    with pytest.raises(InputError, match=says):
        AsciiSettings(**wrong)
    with pytest.raises(InputError, match="count_mm"):
        Nd2xxDecoder(0.0)


@pytest.mark.parametrize("pieces", [1, 7])
def test_a_line_over_the_maximum_is_never_cut_and_believed(pieces: int) -> None:
    """Its first 200 bytes would be a good number."""
    decoder = AsciiDecoder(AsciiSettings(request=b"?"))
    line = b"1.234" + b" " * 195 + b"E3\r\n"
    step = len(line) // pieces + 1
    events = [event for at in range(0, len(line), step) for event in decoder.feed(line[at : at + step])]
    assert [type(event) for event in events] == [BadLine]
    assert decoder.feed(b"5.678\r\n") == [Value(5.678)]


LINES = (b"-      5.23  =A\r\n", b"\x02+123456789\r\n", b"01A+0000.123\r", b"12.5 mm\r\n", b"\x15", b"\x06", b"9" * 300)
noise = st.lists(st.one_of(st.sampled_from(LINES), st.binary(max_size=40)), max_size=12)


@pytest.mark.parametrize(
    ("make", "good"),
    [
        (lambda: Nd2xxDecoder(0.001), b"+   12.3456    \r\n"),
        (lambda: AsciiDecoder(AsciiSettings()), b"12.3456\n"),
        (lambda: AsciiDecoder(MITUTOYO), b"01A+0012.345\r"),
    ],
    ids=["nd2xx", "number", "mitutoyo"],
)
@given(chunks=noise)
@settings(max_examples=25)
def test_nothing_upsets_a_decoder(make: Callable[[], ValueProtocol], good: bytes, chunks: list[bytes]) -> None:
    decoder = make()
    for chunk in chunks:
        for event in decoder.feed(chunk):
            assert isinstance(event, Value | Fault | BadLine)
    assert isinstance(decoder.feed(b"\r\n" + good)[-1], Value)
