"""How many lines of a µMD a minute the parser takes; a display sends 60 000."""

import time

import pytest
from support.bench import Record, row

from drivers.instruments.umd import UmdDecoder

AT_LEAST_PER_MIN, SENT_PER_MIN = 1_000_000, 60_000
LINES = 100_000


@pytest.mark.parametrize("piece_bytes", [200, 4000])
def test_lines_per_minute(piece_bytes: int, record_property: Record) -> None:
    stream = b"\n" + b"".join(b"3276 3281 %d 5 77 %d 3 2150\r\n" % (-15801 - i, i) for i in range(LINES))
    decoder, found = UmdDecoder(), 0
    began = time.process_time()
    for start in range(0, len(stream), piece_bytes):
        found += len(decoder.feed(stream[start : start + piece_bytes]))
    per_min = 60.0 * found / (time.process_time() - began)
    name = f"decoding a µMD, pieces of {piece_bytes} bytes"
    row(record_property, name, per_min, SENT_PER_MIN, "lines/min", beside="a display sends", asked="≥ 16.7")
    assert found == LINES
    assert per_min >= AT_LEAST_PER_MIN
