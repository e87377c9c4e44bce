"""What each simulated instrument can do wrong, as bytes on its pseudo-terminal: nothing of the decoders' has a hand in this."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from itertools import pairwise

import pytest

from sim_backends.bench import Bench, BenchParameters
from sim_backends.faults import Fault, FaultKind
from sim_backends.gauge import GaugeParameters
from sim_backends.laser import LaserParameters
from sim_backends.plant.parameters import ideal_axis

UNIT_MM = 632.9912e-6 / 2 / 1.00027
"""One count of the laser at λ/2, near enough."""


@dataclass(frozen=True)
class Kind:
    """ask: what a reader writes for a line; line: of a sound line, value in its group; lost: of a line without a signal; per_mm."""

    gauge: str
    line: str
    lost: str
    ask: bytes = b""
    per_mm: float = 1.0

    def bench(self, *faults: Fault, drift_um_per_h: float = 0.0) -> Bench:
        laser = LaserParameters(rate_hz=20.0, drift_um_per_h=drift_um_per_h)
        gauge = GaugeParameters(self.gauge, rate_hz=20.0, drift_um_per_h=drift_um_per_h) if self.gauge else None
        return Bench(BenchParameters(plant=ideal_axis(), laser=laser, gauge=gauge, laser_faults=faults))


KINDS = {
    "umd": Kind(
        "", r"\d+ \d+ (-?\d+) -?\d+ \d+ \d+ \d+ -?\d+", r"[1-9]\d* 0 -?\d+ -?\d+ \d+ \d+ \d+ -?\d+", b"", 1.0 / UNIT_MM
    ),
    "nd2xx": Kind("nd2xx", r"([+-][ 0-9.]{10})    ", r"[+-][ 0-9.]{10} \?  ", b"\x02"),
    "nd2xx count": Kind("nd2xx", r"\x02([+-]\d{9})", r"\x02[A-Z .]+", b"\x1bA0200\r", 1e4),
    "mitutoyo": Kind("mitutoyo", r"01A([+-]\d{3}\.\d{4})", "ERROR"),
    "ascii": Kind("ascii", r"([+-]\d+\.\d{4}) mm", "ERROR"),
}
ALL = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS.keys())


def sent_by(kind: Kind, bench: Bench, seconds: float = 2.0) -> bytes:
    """All bytes that a reader finds."""
    port = os.open(bench.laser_path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    found = b""
    try:
        while bench.clock.now_ns() < seconds * 1e9:
            if kind.ask:
                os.write(port, kind.ask)
            bench.clock.sleep_s(0.05)
            try:
                found += os.read(port, 4096)
            except BlockingIOError:
                continue
    finally:
        os.close(port)
    return found


def lines_of(sent: bytes) -> list[str]:
    return [line for line in re.split(r"[\r\n]+", sent.decode("latin-1")) if line]


def values_mm(kind: Kind, sent: bytes) -> list[float]:
    found = [match for line in lines_of(sent) if (match := re.fullmatch(kind.line, line))]
    return [float(match[1].replace(" ", "")) / kind.per_mm for match in found]


def with_fault(kind: Kind, fault: FaultKind, duration_s: float = 0.5, size: float = 0.0) -> bytes:
    with kind.bench(Fault(fault, at_s=0.8, duration_s=duration_s, size=size)) as bench:
        return sent_by(kind, bench)


@ALL
def test_sound_lines_and_no_others(kind: Kind) -> None:
    with kind.bench() as bench:
        sent = sent_by(kind, bench)
    lines = lines_of(sent)
    assert len(lines) >= 30
    assert all(re.fullmatch(kind.line, line) for line in lines)
    assert max(abs(b - a) for a, b in pairwise(values_mm(kind, sent))) < 0.001


@ALL
def test_a_signal_is_lost(kind: Kind) -> None:
    lines = lines_of(with_fault(kind, FaultKind.BEAM_LOST))
    assert sum(bool(re.fullmatch(kind.lost, line)) for line in lines) == pytest.approx(10, abs=1)


@ALL
def test_it_drifts(kind: Kind) -> None:
    with kind.bench(drift_um_per_h=360_000.0) as bench:
        values = values_mm(kind, sent_by(kind, bench))
    assert values[-1] - values[0] == pytest.approx(0.1 * 0.05 * (len(values) - 1), rel=0.05), "0.1 mm/s"


@ALL
def test_a_value_jumps_and_is_back(kind: Kind) -> None:
    values = values_mm(kind, with_fault(kind, FaultKind.GLITCH, duration_s=0.0, size=500.0))
    jumps = [b - a for a, b in pairwise(values) if abs(b - a) > 0.01]
    assert jumps == [pytest.approx(0.5, abs=0.001), pytest.approx(-0.5, abs=0.001)]


@ALL
def test_lines_break_off(kind: Kind) -> None:
    lines = lines_of(with_fault(kind, FaultKind.HALF_LINE))
    broken = [line for line in lines if not re.fullmatch(kind.line, line)]
    assert len(broken) == pytest.approx(10, abs=1)
    assert max(map(len, broken)) < min(len(line) for line in lines if line not in broken)


@ALL
def test_lines_end_otherwise(kind: Kind) -> None:
    sent = with_fault(kind, FaultKind.LINE_ENDS)
    assert set(re.findall(rb"\r\n|\r|\n", sent)) >= {b"\r\n", b"\r", b"\n"}
    assert all(re.fullmatch(kind.line, line) for line in lines_of(sent))


@ALL
def test_there_is_garbage_between(kind: Kind) -> None:
    with kind.bench() as bench:
        usual = set(sent_by(kind, bench))
    assert len(set(with_fault(kind, FaultKind.GARBAGE, size=12.0)) - usual) > 50


@pytest.mark.outside
@ALL
def test_it_falls_silent_and_begins_anew(kind: Kind) -> None:
    with kind.bench() as bench:
        all_lines = len(lines_of(sent_by(kind, bench)))
    silent = with_fault(kind, FaultKind.SILENCE)
    assert all_lines - len(lines_of(silent)) == pytest.approx(10, abs=1)
    with kind.bench(Fault(FaultKind.RESTART, at_s=0.8), drift_um_per_h=3_600_000.0) as bench:
        values = values_mm(kind, sent_by(kind, bench))
    back = [after for before, after in pairwise(values) if after < before]
    assert back == [pytest.approx(0.0, abs=0.001)], "the count begins where it is"
