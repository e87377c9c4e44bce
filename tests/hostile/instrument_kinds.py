"""Kinds of misbehaving instrument: an interceptor between the simulated laser and its terminal rewrites lines of bytes.

A line is `REF MEAS disp vel phase seq lsCode lsData`; disp counts half wavelengths, some 316 nm.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle

from hostile.peer import Kinds, Peer

from drivers.errors import FollowingErrorError, LinkLostError, MeasurementLostError, ProtocolError, UnprovenError
from sim_backends.bench import Bench

LOST = (MeasurementLostError, LinkLostError, ProtocolError)
WRONG = (MeasurementLostError, FollowingErrorError)
COUNT_MM = 632.9912e-6 / 2.0
Lines = list[bytes]


class InstrumentPeer(Peer):
    """The interceptor of one bench's terminal."""

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench.clock, bench.servo)
        self.bench = bench
        self.rewrite: Callable[[bytes], Lines] | None = None
        self.past: Lines = []
        wire = bench.laser._wire
        self._put = wire.put
        wire.put = self._line  # type: ignore[method-assign]

    def _line(self, line: bytes) -> None:
        self.past.append(line)
        lines = [line] if self.rewrite is None else self.rewrite(line)
        if lines != [line]:
            self.strike()
        for each in lines:
            self._put(each)

    def fields(self, change: Callable[[list[int]], None]) -> None:
        """Rewrite the numbers of each line."""

        def rewrite(line: bytes) -> Lines:
            try:
                numbers = [int(word) for word in line.split()]
            except ValueError:
                return [line]
            change(numbers)
            return [b" ".join(b"%d" % number for number in numbers) + b"\r\n"]

        self.rewrite = rewrite


INSTRUMENT_KINDS = kinds = Kinds()


def _displacement(peer: InstrumentPeer, change: Callable[[int], float]) -> None:
    """Change the counted displacement; the phase within a count and all other fields stay."""

    def rewrite(numbers: list[int]) -> None:
        numbers[2] = round(change(numbers[2]))

    peer.fields(rewrite)


@kinds("frozen, with a good status and a live counter", *WRONG)
def _(peer: InstrumentPeer) -> None:
    kept: list[int] = []

    def freeze(numbers: list[int]) -> None:
        kept[:] = kept or numbers
        numbers[2:5] = [kept[2], 0, kept[4]]

    peer.fields(freeze)


@kinds("frozen, counter and all", *LOST)
def _(peer: InstrumentPeer) -> None:
    kept: Lines = []

    def freeze(line: bytes) -> Lines:
        kept[:] = kept or [line]
        return kept[:1]

    peer.rewrite = freeze


# A single step before the datum is taken only shifts a zero that is not set yet: the rows are correct, and are checked.
@kinds("jumps by 1.58 m", *WRONG, passes=True)
def _(peer: InstrumentPeer) -> None:
    _displacement(peer, lambda counts: counts + 5_000_000)


@kinds("jumps by 1 mm", *WRONG, passes=True)
def _(peer: InstrumentPeer) -> None:
    _displacement(peer, lambda counts: counts + 3160)


@kinds("is 0.45 mm beside the truth for 4 s", *WRONG, UnprovenError, passes=True)
def _(peer: InstrumentPeer) -> None:
    """Within the 0.7 mm that a whole travel may differ by."""
    back_ns = peer.clock.now_ns() + 4_000_000_000
    _displacement(peer, lambda counts: counts + (0.45 / COUNT_MM if peer.clock.now_ns() < back_ns else 0.0))


@kinds("replays its past", *LOST, FollowingErrorError)
def _(peer: InstrumentPeer) -> None:
    past = cycle(peer.past[-150:] or [b"1 1 0 0 0 1 0 0\r\n"])
    peer.rewrite = lambda _line: [next(past)]


@kinds("replays its past with a live counter", *WRONG)
def _(peer: InstrumentPeer) -> None:
    past = cycle(peer.past[-150:] or [b"1 1 0 0 0 1 0 0\r\n"])

    def replay(numbers: list[int]) -> None:
        old = [int(word) for word in next(past).split()]
        numbers[2:5] = old[2:5]

    peer.fields(replay)


@kinds("sends garbage", *LOST)
def _(peer: InstrumentPeer) -> None:
    peer.rewrite = lambda line: [peer.random.randbytes(len(line))]


@kinds("sends digits that are no line", *LOST)
def _(peer: InstrumentPeer) -> None:
    peer.rewrite = lambda _line: [b"%d " % peer.random.randrange(10**6) for _ in range(8)]


@kinds("dribbles: a byte in each line's time", *LOST)
def _(peer: InstrumentPeer) -> None:
    kept = bytearray()

    def dribble(line: bytes) -> Lines:
        kept.extend(line)
        first = bytes(kept[:1])
        del kept[:1]
        return [first]

    peer.rewrite = dribble


@kinds("counts with the other sign", *WRONG)
def _(peer: InstrumentPeer) -> None:
    peer.fields(lambda numbers: numbers.__setitem__(slice(2, 5), [-numbers[2], -numbers[3], -numbers[4]]))


@kinds("counts half", *WRONG)
def _(peer: InstrumentPeer) -> None:
    _displacement(peer, lambda counts: counts / 2)


@kinds("counts double", *WRONG)
def _(peer: InstrumentPeer) -> None:
    _displacement(peer, lambda counts: counts * 2)


@kinds("the beam flickers", *LOST)
def _(peer: InstrumentPeer) -> None:
    def flicker(numbers: list[int]) -> None:
        if peer.random.random() < 0.2:
            numbers[1], numbers[4] = 0, 0x800

    peer.fields(flicker)


@kinds("stops sending", *LOST)
def _(peer: InstrumentPeer) -> None:
    peer.rewrite = lambda _line: []


@kinds("its port vanishes", *LOST)
def _(peer: InstrumentPeer) -> None:
    peer.strike()
    peer.bench.close_instrument()
    peer.rewrite = lambda _line: []


@kinds("noise of 1 mm", *WRONG)
def _(peer: InstrumentPeer) -> None:
    _displacement(peer, lambda counts: counts + peer.random.gauss(0.0, 1.0 / COUNT_MM))


@kinds("its status lies: the beam is lost, it counts on", *WRONG)
def _(peer: InstrumentPeer) -> None:
    drift = [0]

    def wander(counts: int) -> float:
        drift[0] += peer.random.randrange(400)
        return counts + drift[0]

    _displacement(peer, wander)


@kinds("floods: every line ten times", *LOST, passes=True)
def _(peer: InstrumentPeer) -> None:
    peer.rewrite = lambda line: [line] * 10


@kinds("floods the line with noise between lines", *LOST, passes=True)
def _(peer: InstrumentPeer) -> None:
    peer.rewrite = lambda line: [peer.random.randbytes(180), line]


@kinds("restarts its counter", *LOST, passes=True)
def _(peer: InstrumentPeer) -> None:
    first: list[int] = []

    def restart(numbers: list[int]) -> None:
        first[:] = first or numbers
        numbers[5] -= first[5] - 1

    peer.fields(restart)
