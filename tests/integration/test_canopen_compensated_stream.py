"""The compensation engine in the stream: every set-point corrected in its cycle, judged at the table and not at the motor.

The machine's errors are written here, apart from the engine and from the plant.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
from support.can_bench import attach_to_wire
from support.can_wire import SimWire

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.stream import CyclicStream
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from hil.correction.compensation import Compensation, MotionHistory
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from sim_backends.bare_shaft import SMALL_SERVO
from sim_backends.clock import SimClock
from sim_backends.servo import SimulatedServo

LEAD_MM = 10.0
BACKLASH_MM = 0.020
PERIOD_S = 0.001


def _pitch_error_mm(motor_mm: float) -> float:
    return 0.015 * math.sin(2 * math.pi * motor_mm / 70.0) + 2e-4 * motor_mm


class WornScrew:
    """A table that follows the nut: pitch error, and a play that is gone through at each reversal."""

    def __init__(self) -> None:
        self.friction_permille = 0.0
        self._nut_mm = 0.0
        self.table_mm = 0.0

    def step(self, motor_rev: float, dt_s: float) -> None:
        del dt_s
        motor_mm = motor_rev * LEAD_MM
        half = BACKLASH_MM / 2
        self._nut_mm = min(max(self._nut_mm, motor_mm - half), motor_mm + half)
        self.table_mm = self._nut_mm + _pitch_error_mm(motor_mm)


def _tables() -> TableSet:
    """Corrections as a calibration would find them: minus the error at rest, arrived at from either side."""
    nodes = np.arange(-5.0, 106.0, 1.0)
    error_um = np.array([1000.0 * _pitch_error_mm(node) for node in nodes])
    half_um = 1000.0 * BACKLASH_MM / 2
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(nodes, -(error_um - half_um), -(error_um + half_um)))


def _path_mm(cycle: int) -> float:
    """To and fro between 5 and 95 mm with up to 90 mm/s, smooth at the reversals."""
    return 50.0 - 45.0 * math.cos(2.0 * cycle * PERIOD_S)


def _stream(compensation: Compensation, cycles: int = 6000) -> tuple[np.ndarray, float]:
    """(errors of the table against the path in µm, host time per cycle in s), once the first stroke is over."""
    clock = SimClock()
    screw = WornScrew()
    servo = SimulatedServo(screw, replace(SMALL_SERVO, feed_forward=1.0))
    clock.attach(servo.advance, bearable=servo.bearable)
    wire = SimWire(clock)
    attach_to_wire(wire, servo, node_id=5)
    limits = DriveLimits(-10.0, 110.0, 150.0, 3000.0)
    errors: list[float] = []
    busy_s = 0.0
    with CanLink(wire.port(), clock) as link:
        drive = CanOpenDrive("X", AxisScaling(100_000, LEAD_MM), limits, clock, link=link, node_id=5)
        with drive:
            drive.enable()
            drive.start_move(_path_mm(0), 50.0)
            drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
            history = MotionHistory(0.0).moved_to(_path_mm(0))
            with CyclicStream([drive], SetPointSettings(PERIOD_S, following_error_mm=3.0)) as stream:
                before_mm = _path_mm(0)
                for cycle in range(1, cycles):
                    target_mm = _path_mm(cycle)
                    start_s = time.thread_time()
                    command = compensation.command(target_mm, history, {})
                    busy_s += time.thread_time() - start_s
                    history = command.history
                    stream.cycle([command.command_mm])
                    # at this SYNC the set-point before has just been reached
                    if cycle > 1600:
                        errors.append(1000.0 * (screw.table_mm - before_mm))
                    before_mm = target_mm
                assert stream.missed_cycles == 0
                assert stream.late_feedback == 0
    return np.array(errors), busy_s / cycles


def test_the_table_follows_the_path_and_not_the_screw() -> None:
    zero = Compensation(TableSet.zero(np.array([0.0, 100.0])))
    plain_um, _ = _stream(zero)
    corrected_um, seconds = _stream(Compensation(_tables()))
    plain, corrected = (float(np.sqrt(np.mean(errors**2))) for errors in (plain_um, corrected_um))
    print(
        f"table error while streaming: {plain:.2f} µm RMS without, {corrected:.2f} µm with; {1e6 * seconds:.0f} µs per set-point"
    )
    assert plain > 15.0
    assert corrected < plain / 10
    assert seconds < PERIOD_S / 2
