"""Gauges over a real pseudo-terminal: what the driver reads is where the axis is, whatever goes wrong on the line."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.errors import InputError, LinkLostError
from drivers.instrument import DistanceInstrument, Reading, ReadingStatus
from drivers.instruments.gauge import Gauge
from hil.axis.axis_file import DisplayConfig, InstrumentConfig
from hil.machine.bench_wiring import with_instrument
from hil.machine.instruments import build_instrument
from sim_backends.bench import Bench, BenchParameters
from sim_backends.faults import Fault, FaultKind
from sim_backends.gauge import GaugeParameters
from sim_backends.plant.parameters import ideal_axis
from sim_backends.virtual_drive import VirtualDrive

pytestmark = pytest.mark.outside

ND = DisplayConfig(9600, 7, "E", 2)
ND_COUNT = DisplayConfig(9600, 7, "E", 2, count_mm=0.0001)
MITUTOYO = DisplayConfig(9600, 8, "N", 1, pattern="mitutoyo", fault="ERROR")
NUMBER = DisplayConfig(9600, 8, "N", 1, pattern="number", fault="ERROR", decimals=4)
ALL = pytest.mark.parametrize(
    ("kind", "display"),
    [("nd2xx", ND), ("nd2xx", ND_COUNT), ("ascii", MITUTOYO), ("ascii", NUMBER)],
    ids=["nd-displayed", "nd-count", "mitutoyo", "number"],
)


class Rig:
    def __init__(self, bench: Bench, gauge: DistanceInstrument) -> None:
        self.bench, self.gauge = bench, gauge
        self.drive = VirtualDrive(bench.servo, bench.parameters.scaling, bench.parameters.limits, bench.clock)
        self.drive.open()

    def listen(self, seconds: float) -> list[Reading]:
        readings: list[Reading] = []
        end_ns = self.bench.clock.now_ns() + round(seconds * 1e9)
        while self.bench.clock.now_ns() < end_ns:
            self.bench.clock.sleep_s(0.05)
            readings += self.gauge.poll()
        return readings

    def go(self, target_mm: float) -> None:
        self.drive.start_move(target_mm, 100.0)
        while not self.drive.sample().target_reached:
            self.bench.clock.sleep_s(0.1)
        self.listen(0.6)


@contextmanager
def rig(kind: str, display: DisplayConfig, *faults: Fault, port: str = "") -> Iterator[Rig]:
    config = InstrumentConfig(kind, "bench", 1, 0.5, display=display)
    parameters = with_instrument(BenchParameters(plant=ideal_axis(), laser_faults=faults), config)
    with Bench(parameters) as bench:
        if port:
            os.symlink(bench.laser_path, port)
        with build_instrument(config, port or bench.laser_path, bench.clock) as gauge:
            yield Rig(bench, gauge)


@ALL
def test_a_gauge_reads_where_the_axis_is(kind: str, display: DisplayConfig) -> None:
    with rig(kind, display) as made:
        made.drive.enable()
        for target_mm in (7.5, 123.456, 0.0):
            made.go(target_mm)
            readings = made.listen(1.0)
            assert len(readings) >= 8
            assert all(reading.status is ReadingStatus.GOOD for reading in readings)
            seen_mm = sum(reading.position_mm or 0.0 for reading in readings) / len(readings)
            assert seen_mm == pytest.approx(made.bench.plant.position_mm, abs=1.5e-4)
        assert isinstance(made.gauge, Gauge)
        assert made.gauge.bad_lines <= 1


@ALL
def test_bad_lines_cost_their_value_and_nothing_else(kind: str, display: DisplayConfig) -> None:
    faults = (
        Fault(FaultKind.HALF_LINE, at_s=5.0, duration_s=0.5),
        Fault(FaultKind.GARBAGE, at_s=6.0, duration_s=0.5, size=9),
        Fault(FaultKind.LINE_ENDS, at_s=7.0, duration_s=0.5),
        Fault(FaultKind.SILENCE, at_s=8.0, duration_s=1.0),
        Fault(FaultKind.GLITCH, at_s=10.0, size=500.0),
    )
    with rig(kind, display, *faults) as made:
        made.drive.enable()
        made.go(200.0)
        made.listen(4.5 - made.bench.clock.now_ns() / 1e9)
        readings = made.listen(7.0)
        here_mm = made.bench.plant.position_mm
        off = [r for r in readings if r.position_mm is None or abs(r.position_mm - here_mm) > 0.001]
        assert [round(r.position_mm - here_mm, 2) for r in off if r.position_mm is not None] == [0.5]
        assert isinstance(made.gauge, Gauge)
        assert made.gauge.bad_lines >= 2
        assert made.listen(1.0)[-1].status is ReadingStatus.GOOD


@ALL
def test_a_scale_that_could_not_be_read_has_lost_its_zero_until_acknowledged(kind: str, display: DisplayConfig) -> None:
    with rig(kind, display, Fault(FaultKind.BEAM_LOST, at_s=2.0, duration_s=0.5)) as made:
        assert {r.status for r in made.listen(1.9)} == {ReadingStatus.GOOD}
        readings = made.listen(2.0)
        assert ReadingStatus.HEAD_ERROR in {one.status for one in readings}
        assert readings[-1].status is ReadingStatus.LOST_BEFORE
        made.gauge.acknowledge_loss()
        assert made.listen(1.0)[-1].status is ReadingStatus.GOOD


def test_a_gauge_that_was_unplugged_is_found_again(tmp_path: Path) -> None:
    port = tmp_path / "ttyGAUGE"
    with rig("nd2xx", ND, port=str(port)) as made:
        assert made.listen(1.0)
        made.bench.close_instrument()
        with pytest.raises(LinkLostError, match="ttyGAUGE is gone"):
            made.listen(1.0)
        with Bench(made.bench.parameters) as again:
            port.unlink()
            port.symlink_to(again.laser_path)
            made.bench.clock.sleep_s(0.6)
            made.bench.clock.attach(lambda now_ns, _dt_s: again.clock.sleep_until_ns(now_ns))
            assert made.listen(1.0)[-1].status is ReadingStatus.LOST_BEFORE
            made.gauge.acknowledge_loss()
            assert made.listen(1.0)[-1].status is ReadingStatus.GOOD


def test_the_bench_says_which_instruments_it_has() -> None:
    own = DisplayConfig(9600, 8, "N", 1, pattern=r"(?P<value>\d+)")
    with pytest.raises(InputError, match="the bench writes patterns"):
        with_instrument(BenchParameters(), InstrumentConfig("ascii", "bench", 1, 0.5, display=own))
    with pytest.raises(InputError, match="gauge kind 'abacus'"):
        GaugeParameters("abacus")
    with Bench(BenchParameters(gauge=GaugeParameters())) as bench, pytest.raises(InputError, match="is a laser's"):
        bench.switch_on("cosine", 5.0)
