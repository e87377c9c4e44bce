"""Kinds of drive that moves without an order or ignores one, for every wire."""

from __future__ import annotations

from typing import Any

from hostile.peer import Kinds, Peer

from drivers.errors import (
    DriveFaultError,
    HeldUnderPowerError,
    MeasurementLostError,
    ProtocolError,
    SafetyError,
    StateError,
)
from hil.desk.stop import StoppedByOperator
from sim_backends.faults import Fault, FaultKind

COUNTS_PER_MM = 100_000.0
MOTION = (SafetyError, ProtocolError, DriveFaultError, StateError)
SERVO_KINDS = kinds = Kinds()


@kinds("acknowledged, but it never moves", *MOTION)
def _(peer: Peer) -> None:
    peer.instead("move_absolute", lambda *_: None)
    peer.instead("cyclic_position", lambda *_: None)


@kinds("it moves the wrong way", *MOTION)
def _(peer: Peer) -> None:
    servo, move, cyclic = peer.servo, peer.servo.move_absolute, peer.servo.cyclic_position
    here = servo.position_actual_counts
    peer.instead("move_absolute", lambda target, v, a: move(2 * servo.position_actual_counts - target, v, a))
    peer.instead("cyclic_position", lambda target: cyclic(2 * here - target))


@kinds("it goes twice as far", *MOTION)
def _(peer: Peer) -> None:
    servo, move, cyclic = peer.servo, peer.servo.move_absolute, peer.servo.cyclic_position
    here = servo.position_actual_counts
    peer.instead("move_absolute", lambda target, v, a: move(2 * target - servo.position_actual_counts, v, a))
    peer.instead("cyclic_position", lambda target: cyclic(2 * target - here))


# 120 mm/s: a look every 50 ms, and 7.2 mm of braking at 1000 mm/s²
@kinds("it runs away", *MOTION, disobeys_mm=13.2)
def _(peer: Peer) -> None:
    move = peer.servo.move_velocity

    def run(target: int, *_: Any) -> None:
        move(-12e6 if target < peer.servo.position_actual_counts else 12e6, 100e6)

    peer.instead("move_absolute", run)
    peer.instead("cyclic_position", run)


AHEAD, AHEAD_MM, AHEAD_S = 1.2, 0.1, 0.06
"""What overspeed is: being ahead, by a fifth and so many mm, of where the told speed leads, and for longer than is between two looks.
A move that is too short to come to its speed is over sooner with three times its ramp, and no faster than it may be."""


@kinds("it moves three times as fast", *MOTION)
def _(peer: Peer) -> None:
    servo, move, quick_stop = peer.servo, peer.servo.move_absolute, peer.servo.quick_stop
    told: list[tuple[int, int, int]] = []  # the last order: when, from where, at which speed
    long: list[bool] = []  # it was ahead for long enough to be seen

    def order(target: int, v: int, a: int) -> None:
        told[:] = [(peer.clock.now_ns(), servo.position_actual_counts, v)]
        move(target, 3 * v, 3 * a)

    raise_fault = servo.raise_fault

    def fault(code: int) -> None:  # its motor does not follow three times the ramp
        peer.strike()
        told.clear()
        raise_fault(code)

    def stop(*arguments: Any) -> None:
        told.clear()  # it was noticed, or is over for another reason
        quick_stop(*arguments)

    def look(now_ns: int, _dt_s: float) -> None:
        for began_ns, from_counts, v in told:
            led_mm = AHEAD * v * (now_ns - began_ns) * 1e-9 / COUNTS_PER_MM + AHEAD_MM
            if abs(servo.position_actual_counts - from_counts) / COUNTS_PER_MM > led_mm:
                peer.strike()
                if not long and peer.struck_ns is not None and now_ns - peer.struck_ns > AHEAD_S * 1e9:
                    long.append(True)
            elif not long:
                peer.struck_ns = None

    servo.move_absolute, servo.quick_stop, servo.raise_fault = order, stop, fault  # type: ignore[method-assign]
    peer.clock.attach(look, bearable=lambda _now_ns: 2_000_000)


@kinds("a fault in mid-move", DriveFaultError)
def _(peer: Peer) -> None:
    peer.strike()
    peer.servo.raise_fault(0x3210)


@kinds("the shaft jams", *MOTION, MeasurementLostError)
def _(peer: Peer) -> None:
    peer.strike()
    peer.servo.schedule((Fault(FaultKind.JAM, peer.clock.now_ns() * 1e-9 + 0.001, 1e6),))


@kinds("quick stop is ignored", StoppedByOperator, stop_after_s=0.3, coasts=True)
def _(peer: Peer) -> None:
    peer.strike()
    peer.instead("quick_stop", lambda *_: None)


@kinds(
    "quick stop and halt are ignored",
    StoppedByOperator,
    HeldUnderPowerError,
    stop_after_s=0.3,
    coasts=True,
)
def _(peer: Peer) -> None:
    peer.strike()
    peer.instead("quick_stop", lambda *_: None)
    peer.instead("halt", lambda *_: None)


@kinds("the operator stops, nothing is wrong", StoppedByOperator, stop_after_s=0.05)
def _(peer: Peer) -> None:
    peer.strike()
