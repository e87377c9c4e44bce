"""Gear ratio, encoder, feed and direction on every wire, by rows worked out by hand: a factor turned over anywhere fails one of them.

The axis: an encoder of 100 000 counts per motor revolution, 5/2 motor revolutions per shaft revolution, 20 mm per shaft revolution,
and the load moves against the counts. 100 000 · 2.5 / 20 = 12 500 counts per mm, and + in mm is − in counts. What the drive is told
is taken from the simulated servo, in counts; what the drive shows is put there, in counts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest
from support.drive_rigs import BACKENDS, COUNTS_PER_REV, Backend, Rig, arrive, home

from drivers.canopen.drive import CanOpenDrive, HomingSettings
from drivers.correction_table import Directions, Interpolation, Nodes, Outside, RawFormat, RawTable, TableDescription
from drivers.drive import Capability, ServoDrive
from drivers.errors import FollowingErrorError, LimitError
from drivers.modbus.drive_values import DriveValues
from drivers.modbus.map_loader import load_drive_map
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from drivers.touch_probe import Edge
from hil.drive_table.curve import DriveCurve
from sim_backends.faults import Fault, FaultKind
from sim_backends.servo import SimulatedServo
from sim_backends.virtual_drive import VirtualDrive

GEARED = AxisScaling(COUNTS_PER_REV, 20.0, Fraction(5, 2), -1)
DIRECT = AxisScaling(
    COUNTS_PER_REV, 8.0, Fraction(1), -1
)  # the same 12 500 counts/mm, for the drive that knows no gear
ON_CANOPEN = pytest.mark.parametrize("backend", [BACKENDS["canopen, simulated wire"]], ids=["canopen"])
ORDERED = 1e-3  # relative: a register in 0.1 rpm is no finer
LAST = -1


@pytest.fixture
def rig(backend: Backend) -> Iterator[Rig]:
    with backend(DIRECT if backend is BACKENDS["in process"] else GEARED) as rig:
        yield rig


def _orders(rig: Rig, name: str, monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """The arguments of each such order that reaches the servo from now on."""
    given: list[tuple[Any, ...]] = []
    carry_out: Callable[..., None] = getattr(rig.servo, name)

    def note(*arguments: Any) -> None:
        given.append(arguments)
        carry_out(*arguments)

    monkeypatch.setattr(rig.servo, name, note)
    return given


def _stream(drive: ServoDrive, *places_mm: float) -> None:
    with drive.stream(SetPointSettings(0.004)) as stream:
        for place_mm in places_mm:
            stream.cycle([place_mm])


# -- the factors themselves --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "um"), [("mm", 10.0), ("um", 0.01), ("counts", 0.0008), ("rev", 80.0)])
def test_units_of_a_table_in_the_drive(unit: str, um: float) -> None:
    """Of 0.01 of each: a count is 1/12 500 mm = 0.08 µm, a motor revolution 100 000 of them = 8 mm."""
    assert RawFormat(unit, 0.01, -1000, 1000).um(GEARED) == pytest.approx(um, rel=1e-12)


def test_what_a_drive_adds_by_its_table() -> None:
    """5 counts subtracted, where counts rise as the load goes back: 5 · 0.08 µm forward."""
    quantity = RawFormat("counts", 1.0, -1000, 1000)
    kept = TableDescription(
        "table", 9, Nodes.EXPLICIT, Interpolation.LINEAR, Outside.HOLD, Directions.ONE, -1, quantity, quantity
    )
    curve = DriveCurve(kept, RawTable((5, 5), (), (-500_000, 0)), GEARED)
    assert curve.value_um(5) == pytest.approx(0.4, rel=1e-12)
    assert curve.correction_um([20.0], [1]) == pytest.approx([0.4], rel=1e-12)
    assert curve.nodes_mm == pytest.approx([0.0, 40.0], abs=1e-12)


def test_a_window_in_motor_revolutions() -> None:
    found = load_drive_map("vendor_style")
    in_rev = replace(found.registers[found.move.target], unit="rev")
    registers = replace(found.registers, registers={**found.registers.registers, found.move.target: in_rev})
    found = replace(found, registers=registers, move=replace(found.move, window=0.002))
    values = DriveValues("X", found, GEARED)
    assert values.window_counts() == pytest.approx(200.0)  # 0.002 rev · 100 000


# -- what the drive is told ---------------------------------------------------------------------------------------------
def test_a_move(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    with rig.drive as drive:
        drive.enable()
        home(rig)
        moves = _orders(rig, "move_absolute", monkeypatch)
        drive.start_move(40.0, 30.0)
        target, velocity, acceleration = moves[LAST]
        assert target == -500_000  # 40 mm · 12 500 · −1
        assert velocity == pytest.approx(375_000, rel=ORDERED)  # 30 mm/s · 12 500
        # 2000 mm/s² · 12 500; the drive in this process has ramps of its own, 400 mm/s²
        assert acceleration == pytest.approx(5_000_000 if isinstance(drive, VirtualDrive) else 25_000_000, rel=ORDERED)
        assert arrive(rig) == pytest.approx(40.0, abs=1e-3)
        assert rig.servo.motor_rev == pytest.approx(-5.0, abs=1e-3)  # 40 mm are 2 turns of the shaft, 5 of the motor


def test_a_stream_of_positions(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    with rig.drive as drive:
        if Capability.STREAMING not in drive.capabilities:
            pytest.skip("the drive takes no stream")
        drive.enable()
        home(rig)
        given = _orders(rig, "cyclic_position", monkeypatch)
        with drive.stream(SetPointSettings(0.04)) as stream:
            for place_mm in (0.8, *[1.6] * 8):
                stream.cycle([place_mm])
            assert stream.found[0][1] == pytest.approx(1.6, abs=2e-3)
        targets = [target for (target,) in given]
        assert targets.index(-10_000) < targets.index(-20_000)  # 0.8 and 1.6 mm · 12 500 · −1
        assert min(targets) == -20_000


@ON_CANOPEN
def test_a_step_is_one_of_the_load(rig: Rig) -> None:
    """200 mm/s · 4 ms are 0.8 mm a cycle, 10 000 counts."""
    with rig.drive as drive:
        drive.enable()
        home(rig)
        with pytest.raises(LimitError, match=r"step of 0\.81\d* mm"):
            _stream(drive, 0.79, 0.79 + 0.81)


@ON_CANOPEN
def test_a_following_error_is_one_of_the_load(rig: Rig) -> None:
    """The shaft is jammed; 0.3 mm a cycle are more than 1 mm off after the fourth."""
    with rig.drive as drive:
        drive.enable()
        home(rig)
        rig.servo.schedule((Fault(FaultKind.JAM, rig.clock.now_ns() * 1e-9 + 0.001, 60.0),))
        with pytest.raises(FollowingErrorError, match=r" 1\.[0-3]\d* mm"):
            _stream(drive, *(0.3 * step for step in range(1, 20)))


@pytest.mark.parametrize(
    "backend", [BACKENDS["canopen, simulated wire"], BACKENDS["in process"]], ids=["canopen", "in process"]
)
def test_homing_speeds_and_the_home_position(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    drive = rig.drive
    if isinstance(drive, CanOpenDrive):
        drive.settings = replace(drive.settings, homing=HomingSettings(37, 16.0, 0.8, 4.0))
    else:
        assert isinstance(drive, VirtualDrive)
        settings = drive.settings
        settings.homing_speed_switch_mm_s, settings.homing_speed_zero_mm_s, settings.home_position_mm = 16.0, 0.8, 4.0
    with drive:
        drive.enable()
        homings = _orders(rig, "start_homing", monkeypatch)
        home(rig)
        assert homings == [(37, 200_000, 10_000, -50_000)]  # 16 and 0.8 mm/s, unsigned; 4 mm · 12 500 · −1
        assert drive.sample().position_load_mm == pytest.approx(4.0, abs=1e-3)


# -- what the drive shows -------------------------------------------------------------------------------------------------
def test_a_sample(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = {
        "position_actual_counts": -500_000,
        "velocity_actual_counts_s": -375_000,
        "torque_actual_permille": -123,
        "following_error_counts": -2_500,
    }
    with rig.drive as drive:
        for name, counts in shown.items():
            monkeypatch.setattr(SimulatedServo, name, property(lambda _servo, counts=counts: counts))
        sample = drive.sample()
        assert sample.position_load_mm == pytest.approx(40.0, abs=1e-3)  # −500 000 / 12 500 · −1
        assert sample.velocity_mm_s == pytest.approx(30.0, rel=ORDERED)  # −375 000 / 12 500 · −1
        assert sample.torque_percent == pytest.approx(12.3, abs=0.05)  # −123 / 10 · −1
        assert sample.following_error_mm == pytest.approx(0.2, abs=1e-3)  # −2 500 / 12 500 · −1
        monkeypatch.undo()


def test_a_latched_position(rig: Rig) -> None:
    with rig.drive as drive:
        if Capability.TOUCH_PROBE not in drive.capabilities or rig.probe is None:
            pytest.skip("the drive has no touch probe")
        drive.enable()
        home(rig)
        rig.probe.attach(1, lambda counts: counts <= -100_000)  # closed from 8 mm on
        probe = drive.touch_probe()
        probe.arm(1, [Edge.POSITIVE])
        drive.start_move(12.0, 100.0)
        arrive(rig)
        assert [latch.position_load_mm for latch in probe.poll()] == pytest.approx([8.0], abs=2e-4)
