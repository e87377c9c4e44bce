"""The whole path: servo moves the plant, the laser samples it, a real serial port carries the lines, the driver makes millimetres."""

import itertools
import statistics
from collections.abc import Iterator
from dataclasses import replace

import pytest

from drivers.errors import LinkLostError
from drivers.instrument import Reading, ReadingStatus
from drivers.instruments.serial_link import SerialLink
from drivers.instruments.umd_laser import BesideOptics, UmdLaser, UmdSettings
from sim_backends.bench import Bench, BenchParameters
from sim_backends.faults import Fault, FaultKind
from sim_backends.laser import LaserParameters
from sim_backends.plant.parameters import geometric_axis
from sim_backends.virtual_drive import VirtualDrive

pytestmark = pytest.mark.outside

SETTINGS = UmdSettings(places={"screw": 4})


class Rig:
    """Bench, drive and instrument."""

    def __init__(self, parameters: BenchParameters, settings: UmdSettings = SETTINGS) -> None:
        self.bench = Bench(parameters)
        self.drive = VirtualDrive(self.bench.servo, parameters.scaling, parameters.limits, self.bench.clock)
        self.laser = UmdLaser(SerialLink(self.bench.laser_path), self.bench.clock, settings)
        self.drive.open()
        self.laser.open()

    def close(self) -> None:
        self.laser.close()
        self.drive.close()
        self.bench.close()

    def listen(self, seconds: float, every_s: float = 0.1) -> list[Reading]:
        readings: list[Reading] = []
        end = self.bench.clock.now_ns() + round(seconds * 1e9)
        while self.bench.clock.now_ns() < end:
            self.bench.clock.sleep_s(every_s)
            readings += self.laser.poll()
        return readings

    def measure(self, seconds: float = 0.6) -> float:
        self.listen(0.2)
        readings = self.listen(seconds)
        assert readings
        assert all(r.status is ReadingStatus.GOOD for r in readings)
        return statistics.fmean(r.position_mm for r in readings)

    def go(self, target_mm: float, speed_mm_s: float = 100.0) -> list[Reading]:
        """The readings on the way."""
        self.drive.start_move(target_mm, speed_mm_s)
        readings = []
        while not self.drive.sample().target_reached:
            readings += self.listen(0.1)
        return readings


@pytest.fixture
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    made = Rig(getattr(request, "param", BenchParameters()))
    yield made
    made.close()


def test_the_instrument_sees_the_machines_true_error(rig: Rig) -> None:
    """Over a bidirectional grid within noise: 30 nm per sample over 30 samples, and the air's sensors."""
    rig.drive.enable()
    seen, true = [], []
    for grid in (range(3, 500, 62), range(490, 0, -62)):
        for target in grid:
            rig.go(float(target))
            seen.append((rig.measure() - target) * 1000.0)
            true.append(rig.bench.plant.error_um)
    differences = [a - b for a, b in zip(seen, true, strict=True)]
    assert max(true) - min(true) > 10.0  # there is something to see
    assert max(map(abs, differences)) < 0.05
    assert statistics.pstdev(differences) < 0.02
    assert rig.bench.laser.counters.dropped_lines == 0


def test_environment_arrives_with_its_scales(rig: Rig) -> None:
    rig.listen(1.0)
    environment = rig.laser.environment()
    ambient, thermal = rig.bench.plant.ambient, rig.bench.plant.thermal
    assert environment.air_temp_c == pytest.approx(ambient.air_c, abs=0.1)
    assert environment.air_pressure_hpa == pytest.approx(ambient.pressure_hpa, abs=0.5)
    assert environment.air_humidity_percent == pytest.approx(ambient.humidity_percent, abs=3.0)
    assert environment.place_temps_c["screw"] == pytest.approx(thermal.state.screw_c, abs=0.1)
    assert rig.laser.sample_rate_hz == 50.0


@pytest.mark.parametrize("rig", [BenchParameters(laser=LaserParameters(angle_urad_per_unit=0.5))], indirect=True)
def test_angle_optics_show_the_tables_pitch_and_yaw(rig: Rig) -> None:
    beside = {"pitch_urad": BesideOptics(2, 0.5), "yaw_urad": BesideOptics(3, 0.5)}
    rig.laser = UmdLaser(SerialLink(rig.bench.laser_path), rig.bench.clock, replace(SETTINGS, beside=beside))
    rig.laser.open()
    rig.bench.switch_on("abbe", 10.0)
    rig.drive.enable()
    seen = []
    for target in (20.0, 250.0, 480.0):
        rig.go(target)
        rig.measure()
        plant, found = rig.bench.plant, rig.laser.environment().beside
        noise = plant.parameters.sensors.angle_urad
        assert found["pitch_urad"] == pytest.approx(plant.pitch_urad, abs=6 * noise + 0.01)
        assert found["yaw_urad"] == pytest.approx(plant.yaw_urad, abs=6 * noise + 0.01)
        seen.append(found["pitch_urad"])
    assert max(seen) - min(seen) > 1.0


def test_nobody_reading_leaves_a_gap_and_no_deadlock(rig: Rig) -> None:
    rig.listen(1.0)
    rig.bench.clock.sleep_s(120.0)
    readings = rig.listen(1.0)
    assert sum(reading.lost_before for reading in readings) == rig.bench.laser.counters.dropped_lines > 4000
    assert rig.laser.bad_lines == 1  # joined in mid-line, as far as it could know
    assert readings[-1].sequence == rig.bench.laser.counters.samples


@pytest.mark.parametrize(
    "rig",
    [BenchParameters(laser_faults=(Fault(FaultKind.BEAM_LOST, at_s=5.0, duration_s=0.1),))],
    indirect=True,
)
def test_a_lost_beam_takes_the_zero_with_it(rig: Rig) -> None:
    readings = rig.listen(10.0)
    lost = [r for r in readings if r.status is ReadingStatus.BEAM_LOST]
    assert all(r.position_mm is None for r in lost)
    assert readings[-1].status is ReadingStatus.LOST_BEFORE
    rig.laser.acknowledge_loss()
    after = rig.measure()
    assert abs(after - readings[0].position_mm) > 1.0  # counts were lost for 0.1 s at 2 MHz


@pytest.mark.parametrize(
    "rig",
    [
        BenchParameters(
            laser_faults=(
                Fault(FaultKind.HALF_LINE, at_s=2.0),
                Fault(FaultKind.GARBAGE, at_s=3.0, duration_s=0.2, size=20),
                Fault(FaultKind.SILENCE, at_s=4.0, duration_s=0.5),
                Fault(FaultKind.LINE_ENDS, at_s=5.0, duration_s=1.0),
                Fault(FaultKind.GLITCH, at_s=7.0, size=500.0),
            )
        )
    ],
    indirect=True,
)
def test_a_bad_line_costs_its_sample_and_nothing_else(rig: Rig) -> None:
    readings = rig.listen(8.0)
    assert all(r.status is ReadingStatus.GOOD for r in readings)
    first, last = readings[0].sequence, readings[-1].sequence
    missing = (last - first + 1) - len(readings)
    assert missing == sum(r.lost_before for r in readings)
    assert 1 + 25 <= missing <= 1 + 25 + 11  # a half line, half a second of silence, the lines after garbage
    assert rig.laser.bad_lines >= 2
    positions = [r.position_mm for r in readings]
    jumps = [abs(b - a) for a, b in itertools.pairwise(positions)]
    assert sum(jump > 0.1 for jump in jumps) == 2  # the glitch, up and down again


def test_a_port_that_vanishes_is_a_lost_link(rig: Rig) -> None:
    rig.listen(0.5)
    rig.bench.laser.close()
    with pytest.raises(LinkLostError, match="is gone"):
        rig.listen(0.5)
    rig.bench.clock.sleep_s(1.0)  # the clock does not mind


def test_a_port_that_is_not_there_is_a_lost_link(tmp_path: object) -> None:
    with pytest.raises(LinkLostError, match="cannot be opened"):
        SerialLink(f"{tmp_path}/nothing").open()


@pytest.mark.parametrize("rig", [BenchParameters(plant=geometric_axis(2))], indirect=True)
@pytest.mark.parametrize(
    ("effect", "expected_um"),
    [("backlash", -4.0), ("cosine", -8.0 * 440.0 / 500.0), ("datum_step", 8.0), ("local_wear", 0.0)],
)
def test_an_effect_switched_on_while_it_runs_reaches_the_reading(rig: Rig, effect: str, expected_um: float) -> None:
    """What a model does not hold, over the wire: the same place from the same side, before and after."""
    rig.drive.enable()
    rig.go(400.0)
    rig.go(440.0)
    before = rig.measure()
    rig.bench.switch_on(effect, 8.0)
    rig.go(400.0)
    rig.go(440.0)
    rig.listen(300.0)
    assert (rig.measure() - before) * 1000.0 == pytest.approx(expected_um, abs=0.1)


@pytest.mark.parametrize(
    ("rig", "status"),
    [
        (
            BenchParameters(laser_faults=(Fault(FaultKind.HEAD_ERROR, at_s=1.0, duration_s=1.0),)),
            ReadingStatus.HEAD_ERROR,
        ),
        (BenchParameters(laser_faults=(Fault(FaultKind.OVERSPEED, at_s=1.0),)), ReadingStatus.OVERSPEED),
    ],
    indirect=["rig"],
)
def test_a_signal_error_has_its_name(rig: Rig, status: ReadingStatus) -> None:
    assert {r.status for r in rig.listen(0.9)} == {ReadingStatus.GOOD}
    after = [one.status for one in rig.listen(2.0)]
    assert status in after
    assert after[-1] in (status, ReadingStatus.LOST_BEFORE)


@pytest.mark.parametrize("rig", [BenchParameters(laser=LaserParameters(reference_hz=2.5e5))], indirect=True)
def test_moving_faster_than_the_head_follows_is_overspeed_by_itself(rig: Rig) -> None:
    """A head of 250 kHz follows λ/2 × 250 kHz = 79 mm/s."""
    rig.drive.enable()
    assert {reading.status for reading in rig.go(50.0, 70.0)} == {ReadingStatus.GOOD}
    assert ReadingStatus.OVERSPEED in {reading.status for reading in rig.go(150.0, 90.0)}
