"""Speed, printed with -s: the decoder in lines per second, the bench in simulated seconds per second.

The figures are for reading: what a slow host may make of them is no fault. The bounds only catch disasters.
"""

import random
import time
from collections.abc import Callable

import pytest

from drivers.instruments.serial_link import SerialLink
from drivers.instruments.umd import UmdDecoder, UmdSample
from drivers.instruments.umd_laser import UmdLaser
from sim_backends.bench import Bench, BenchParameters
from sim_backends.virtual_drive import VirtualDrive

pytestmark = pytest.mark.slow


def test_decoder_throughput(record_property: Callable[[str, object], None]) -> None:
    rng = random.Random(1)
    stream = b"".join(
        b"3276 %d %d %d %d %d 3 2250\r\n"
        % (3276 + rng.randrange(9), rng.randrange(-(10**7), 10**7), 5, rng.randrange(512), i)
        for i in range(200_000)
    )
    decoder, found = UmdDecoder(), 0
    start = time.perf_counter()
    for at in range(0, len(stream), 4096):
        found += sum(isinstance(event, UmdSample) for event in decoder.feed(stream[at : at + 4096]))
    rate = found / (time.perf_counter() - start)
    print(f"\nµMD decoder: {rate:,.0f} lines/s")
    record_property("lines_per_s", rate)
    assert found == 199_999
    assert rate > 3_000, "no faster than an instrument sends"


@pytest.mark.parametrize("every_s", [0.02, 0.1])
def test_a_campaign_in_simulated_time(every_s: float, record_property: Callable[[str, object], None]) -> None:
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
    print(
        f"\ncampaign polled every {every_s * 1000:.0f} ms: {simulated_s:.0f} s in {wall_s:.2f} s, × {simulated_s / wall_s:.0f}"
    )
    record_property("simulated_per_real", simulated_s / wall_s)
    assert readings > 0.95 * simulated_s * p.laser.rate_hz
    assert simulated_s > wall_s, "not even as fast as a machine"
