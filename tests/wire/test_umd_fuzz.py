"""Whatever bytes arrive, in whatever pieces: only events, all bytes accounted for, bounded memory, and good lines are found."""

import gc
import random
import tracemalloc
from collections.abc import Iterator

from hypothesis import given
from hypothesis import strategies as st

from drivers.instruments.umd import MAX_LINE_BYTES, UmdDecoder, UmdSample

int32 = st.integers(-(2**31), 2**31 - 1)
counts = st.integers(0, 2**31 - 1)
good_line = st.builds(
    lambda ref, meas, rest: (" ".join(map(str, (ref, meas, *rest)))).encode(),
    counts,
    counts,
    st.lists(int32, min_size=6, max_size=6),
)
noise = st.one_of(
    st.binary(max_size=60),
    st.text("0123456789 -\r\n", max_size=60).map(str.encode),
    st.binary(min_size=MAX_LINE_BYTES, max_size=3 * MAX_LINE_BYTES),
)


@given(st.lists(st.one_of(good_line, noise), max_size=10), st.lists(st.integers(1, 50), min_size=1, max_size=30))
def test_the_pieces_do_not_matter(lines: list[bytes], cuts: list[int]) -> None:
    stream = b"\r\n".join([b"", *lines]) + b"\r\n"
    short = all(len(line) <= MAX_LINE_BYTES for line in stream.replace(b"\r", b"\n").split(b"\n"))
    whole = UmdDecoder().feed(stream)
    decoder = UmdDecoder()
    cut_events = []
    at = i = 0
    while at < len(stream):
        step = cuts[i % len(cuts)]
        cut_events += decoder.feed(stream[at : at + step])
        at, i = at + step, i + 1
    if short:
        assert cut_events == whole
    else:  # an overlong line is given up as soon as it is too long, so its raw bytes may end earlier
        assert [e for e in cut_events if isinstance(e, UmdSample)] == [e for e in whole if isinstance(e, UmdSample)]


FUZZED_BYTES = 150_000  # 10 000 000 by hand: 20 s, and the same verdict
GOOD = b"3276 3281 -15801 5 77 4711 3 2150"


def pieces(rng: random.Random) -> Iterator[bytes]:
    """Noise of several kinds, up to 300 bytes each: of the whole byte, of the protocol's alphabet, and good lines cut and spoilt."""
    while True:
        size = rng.randint(1, 300)
        kind = rng.randrange(4)
        if kind == 0:
            yield rng.randbytes(size)
        elif kind == 1:
            yield bytes(rng.choices(b"0123456789- \r\n", k=size))
        elif kind == 2:
            yield b"9" * size
        else:
            line = bytearray(b"%d %d %d 0 0 %d 3 2150\r\n" % tuple(rng.randrange(10**6) for _ in range(4)))
            line[rng.randrange(len(line))] = rng.randrange(256)
            yield bytes(line[: rng.randint(1, len(line))])


def held_bytes() -> int:
    """What is allocated, without what the interpreter keeps to use again."""
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def test_a_long_stream_of_noise_costs_no_memory_and_hides_no_good_line() -> None:
    rng, decoder = random.Random(1), UmdDecoder()
    expected = UmdSample(*map(int, GOOD.split()))
    fed = found = 0
    tracemalloc.start()
    try:
        before = held_bytes()
        for piece in pieces(rng):
            decoder.feed(piece)
            fed += len(piece)
            if rng.random() < 0.02:
                *_, last = decoder.feed(b"\n" + GOOD + b"\r\n")
                assert last == expected
                found += 1
            if fed >= FUZZED_BYTES:
                break
        after = held_bytes()
    finally:
        tracemalloc.stop()
    assert found > 10
    assert abs(after - before) < 10_000, f"{before} bytes held before, {after} after"
