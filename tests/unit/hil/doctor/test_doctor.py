"""The preflight on a bench: what the drive claims is asked before anything moves, and gross mistakes move little."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from fractions import Fraction

import pytest
from support.can_bench import attach_to_wire
from support.can_wire import SimWire

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.drive import DriveSample, ServoDrive
from drivers.instruments.serial_link import SerialLink
from drivers.instruments.umd_laser import UmdLaser
from drivers.scaling import AxisScaling
from hil.axis.axis_file import MeasurementConfig
from hil.doctor.procedure import CAREFUL_MM_S, Check, doctor, explain_ratio, explain_speed
from hil.machine.session import AxisSession
from sim_backends.bench import Bench, BenchParameters
from sim_backends.plant.parameters import geometric_axis
from sim_backends.virtual_drive import VirtualDrive

HOW = MeasurementConfig(
    targets_mm=(10.0, 20.0),
    runs=1,
    velocity_mm_s=50.0,
    overrun_mm=1.0,
    dwell_s=0.2,
    reading_s=0.2,
    reference_mm=10.0,
    home=True,
    seed=1,
)
PARAMETERS = BenchParameters(plant=geometric_axis(3))
Objects = Mapping[tuple[int, int], int]


@contextmanager
def canopen(bench: Bench, objects: Objects) -> Iterator[ServoDrive]:
    wire = SimWire(bench.clock)
    attach_to_wire(wire, bench.servo, 1, parameters={**PARAMETERS.objects, **objects})
    with CanLink(wire.port(), bench.clock) as link:
        yield CanOpenDrive("X", PARAMETERS.scaling, PARAMETERS.limits, bench.clock, link=link, node_id=1)


def examine(bench: Bench, drive: ServoDrive, **how: bool) -> dict[str, Check]:
    laser = UmdLaser(SerialLink(bench.laser_path), bench.clock)
    with AxisSession(drive, laser, HOW) as session:
        return {check.name: check for check in doctor(session, **how)}


class Reach:
    """How far the table ever was from where it began."""

    def __init__(self, bench: Bench) -> None:
        self.mm = 0.0
        start_mm = bench.plant.position_mm

        def look(_now_ns: int, _dt_s: float) -> None:
            self.mm = max(self.mm, abs(bench.plant.position_mm - start_mm))

        bench.clock.attach(look)


def test_a_drive_that_agrees_is_asked_and_then_proven() -> None:
    with Bench(PARAMETERS) as bench, canopen(bench, {}) as drive:
        checks = examine(bench, drive)
    assert list(checks) == ["drive", "limits", "scaling", "units of motion", "zero", "instrument", "speed", "units"]
    assert "velocity in counts/s, by the standard" in checks["units of motion"].detail
    assert all(check.good for check in checks.values())
    assert "100000 counts/mm: as the axis file" in checks["scaling"].detail


@pytest.mark.parametrize(
    ("objects", "words"),
    [
        ({(0x608F, 1): 250_000, (0x6092, 1): 250_000, (0x60A8, 0): 0xB5 << 16}, "quadrature counted twice"),
        ({(0x6091, 1): 2, (0x6092, 1): 2_000_000, (0x60A8, 0): 0xB5 << 16}, "the gear is left out"),
        ({(0x6092, 1): 500_000}, "feed_mm_per_shaft_rev is 10 (2 times the drive's: a double-start"),
        (
            {(0x60A8, 0): 0xFA << 24 | 0x01 << 16},
            "feed_mm_per_shaft_rev is 10 (0.01 of the drive's: a wrong power of ten",
        ),
    ],
)
def test_a_contradiction_is_named_and_nothing_moves_until_the_file_is_trusted(objects: Objects, words: str) -> None:
    with Bench(PARAMETERS) as bench, canopen(bench, objects) as drive:
        reach = Reach(bench)
        checks = examine(bench, drive)
        assert not checks["scaling"].good
        assert words in checks["scaling"].detail
        assert "units" not in checks
        assert reach.mm == 0.0
    with Bench(PARAMETERS) as bench, canopen(bench, objects) as drive:
        checks = examine(bench, drive, trust_file=True)
        assert words in checks["scaling"].detail
        assert checks["units"].good, "here the axis file was right"


def test_units_that_cannot_be_read_are_a_failed_check_and_no_move() -> None:
    class Refusing(VirtualDrive):
        def reported_scaling(self) -> tuple:  # type: ignore[type-arg]
            from drivers.errors import AbortError  # noqa: PLC0415

            raise AbortError("608Fh: no access", 0x06010001)

    with Bench(PARAMETERS) as bench:
        checks = examine(bench, Refusing(bench.servo, PARAMETERS.scaling, PARAMETERS.limits, bench.clock))
    assert not checks["scaling"].good
    assert "608Fh: no access" in checks["scaling"].detail
    assert "units" not in checks


@pytest.mark.parametrize(
    ("scaling", "words", "reach_mm"),
    [
        (replace(PARAMETERS.scaling, encoder_counts_per_motor_rev=20_000_000), "wrong by that factor", 1.0),
        (replace(PARAMETERS.scaling, encoder_counts_per_motor_rev=10_000_000), "factor of 10", 1.0),
        (replace(PARAMETERS.scaling, encoder_counts_per_motor_rev=4_000_000), "factor of 4", 1.0),
        (replace(PARAMETERS.scaling, feed_mm_per_shaft_rev=20.0), "factor of 1/2", 2.1),
        (replace(PARAMETERS.scaling, direction=-1), "direction is reversed", 4.1),
        (PARAMETERS.scaling, "mm for each mm commanded", 4.1),
    ],
)
def test_the_move_tells_each_mistake_by_its_factor_and_gross_ones_move_little(
    scaling: AxisScaling, words: str, reach_mm: float
) -> None:
    limits = replace(PARAMETERS.limits, travel_min_mm=-600.0)
    parameters = replace(PARAMETERS, servo=replace(PARAMETERS.servo, start_counts=20_000_000.0))
    with Bench(parameters) as bench:
        reach = Reach(bench)
        checks = examine(bench, VirtualDrive(bench.servo, scaling, limits, bench.clock))
        assert words in checks["units"].detail
        assert checks["units"].good is (scaling == PARAMETERS.scaling)
        assert reach.mm < reach_mm


class Faster(VirtualDrive):
    """Its unit of velocity is another one than it was told in."""

    factor = 1.0

    def __init__(self, bench: Bench, factor: float) -> None:
        super().__init__(bench.servo, PARAMETERS.scaling, PARAMETERS.limits, bench.clock)
        self.factor = factor
        self.told_mm_s: list[float] = []

    def _start_move(self, position_load_mm: float, velocity_mm_s: float) -> None:
        self.told_mm_s.append(velocity_mm_s)
        super()._start_move(position_load_mm, self.factor * velocity_mm_s)


@pytest.mark.parametrize(
    ("factor", "words", "stopped"),
    [
        (60.0, "runs too fast: ", True),
        (1.5, "runs too fast: ", True),
        (1.15, "wrong by that factor", False),
        (0.5, "wrong by that factor; or an override, or a speed limit", False),
        (0.1, "not over within", True),
        (0.2, "the drive's unit of velocity is wrong", False),
        (1.0, "the motor moved at 2.5 mm/s when 2.5 mm/s were commanded", False),
    ],
)
def test_the_speed_is_proven_by_the_clock_before_anything_moves_fast(factor: float, words: str, stopped: bool) -> None:
    with Bench(PARAMETERS) as bench:
        reach, drive = Reach(bench), Faster(bench, factor)
        checks = examine(bench, drive)
        assert words in checks["speed"].detail
        assert checks["speed"].good is (factor == 1.0)
        assert ("units" in checks) is (factor == 1.0)
        assert reach.mm < 4.1
    slowly = 0.01 * PARAMETERS.limits.max_velocity_mm_s
    assert set(drive.told_mm_s[:3]) == {CAREFUL_MM_S}
    assert set(drive.told_mm_s[3:5]) <= {slowly}
    assert (HOW.velocity_mm_s in drive.told_mm_s) is (factor == 1.0)
    assert checks["speed"].detail.endswith("the axis was stopped") is stopped


class Late(Faster):
    """Read by a busy computer: it takes a while until a sample is asked for, and again until its answer is taken."""

    def __init__(self, bench: Bench, factor: float, late_s: float) -> None:
        super().__init__(bench, factor)
        self.late_s, self.rng = late_s, random.Random(7)

    def sample(self) -> DriveSample:
        asked_ns = self.clock.now_ns()
        self.clock.sleep_s(self.rng.uniform(0.0, self.late_s))
        taken = super().sample()
        self.clock.sleep_s(self.rng.uniform(0.0, self.late_s))
        return replace(taken, time_ns=self.clock.now_ns(), since_ns=asked_ns)


@pytest.mark.parametrize(("late_s", "factor"), [(0.05, 1.0), (0.15, 1.0), (0.25, 1.0), (0.15, 0.2), (0.05, 0.5)])
def test_a_busy_computer_is_not_taken_for_a_wrong_unit_nor_hides_one(late_s: float, factor: float) -> None:
    with Bench(PARAMETERS) as bench:
        speed = examine(bench, Late(bench, factor, late_s))["speed"]
    assert speed.good is (factor == 1.0), speed.detail


def test_seconds_and_minutes_are_told() -> None:
    assert "seconds taken for minutes" in explain_speed(1.0, 60.0)
    assert "a wrong power of ten" in explain_speed(0.1, 1.0)
    assert "minutes taken for seconds" in explain_speed(60.0, 1.0)


def test_what_a_drive_found_worth_noting_is_told() -> None:
    with Bench(PARAMETERS) as bench, canopen(bench, {(0x6085, 0): 1000}) as drive:
        checks = examine(bench, drive, move=False)
    assert checks["note"].good
    assert "quick stop (6085h)" in checks["note"].detail


def test_a_gear_in_the_axis_file_is_compared_exactly() -> None:
    """1/3 is no float."""
    scaling = AxisScaling(3_000_000, 10.0, Fraction(1, 3))
    with Bench(PARAMETERS) as bench:
        wire = SimWire(bench.clock)
        attach_to_wire(wire, bench.servo, 1, parameters=PARAMETERS.objects)
        with CanLink(wire.port(), bench.clock) as link:
            drive = CanOpenDrive("X", scaling, PARAMETERS.limits, bench.clock, link=link, node_id=1)
            assert examine(bench, drive)["scaling"].good


def test_ratios_in_words() -> None:
    assert "does not follow the motor" in explain_ratio(0.001)
    assert "reversed" in explain_ratio(-2.0)
    assert "factor of 2" in explain_ratio(-2.0)
