"""Speed of the simulated machine with drive and laser polled: simulated seconds per second.

The figures are for reading: what a slow host may make of them is no fault. The bounds only catch disasters.
"""

import time

import pytest
from support.bench import Record, row

from drivers.instruments.serial_link import SerialLink
from drivers.instruments.umd_laser import UmdLaser
from sim_backends.bench import Bench, BenchParameters
from sim_backends.virtual_drive import VirtualDrive

pytestmark = pytest.mark.outside


@pytest.mark.parametrize("every_s", [0.02, 0.1])
def test_a_campaign_in_simulated_time(every_s: float, record_property: Record) -> None:
    p = BenchParameters()
    with (
        Bench(p) as bench,
        VirtualDrive(bench.servo, p.scaling, p.limits, bench.clock) as drive,
        UmdLaser(SerialLink(bench.laser_path), bench.clock) as laser,
    ):
        drive.enable()
        start, readings = time.perf_counter(), 0
        for _run in range(5):
            for target in [*range(0, 501, 25), *range(500, -1, -25)]:
                drive.start_move(float(target), 100.0)
                while not drive.sample().target_reached:
                    bench.clock.sleep_s(every_s)
                    readings += len(laser.poll())
                end = bench.clock.now_ns() + 2_000_000_000
                while bench.clock.now_ns() < end:
                    bench.clock.sleep_s(every_s)
                    readings += len(laser.poll())
        wall_s = time.perf_counter() - start
        simulated_s = bench.clock.now_ns() / 1e9
    name = f"a simulated campaign, polled every {every_s * 1000:.0f} ms"
    row(record_property, name, simulated_s / wall_s, 1.0, "s/s", beside="a machine", asked="> 1")
    assert readings > 0.95 * simulated_s * p.laser.rate_hz
    assert simulated_s > wall_s, "not even as fast as a machine"
