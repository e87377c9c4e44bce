"""Time from the operator's stop to the stop on the wire, in simulated time: one verb, stopped once, at one moment.

On CANopen the stop is the first frame, by SDO or RPDO, whose controlword takes the motion or the power away; on Modbus it is the order
to the drive's servo, and the requests sent before it are counted, as replies take real time.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from hostile.can_peer import RPDOS, SDO_ANSWER, SDO_REQUEST, CanPeer
from hostile.judge import WALL_S, HangError, Truth, ended_after, undisturbed_s
from hostile.modbus_kinds import ModbusPeer
from hostile.modbus_kinds import stand_in as behind_proxy
from hostile.peer import when_due
from hostile.places import VERBS, Place

import hil.machine.bench_modbus
import hil.probe.wiring
from hil.desk.stop import Pacing, Stop
from sim_backends.bench import Bench

BOUND_S = 0.020
"""Longest time from the stop to its frame on CAN, s."""
BOUND_REQUESTS = 1
"""Largest number of requests before it on Modbus: the one in progress."""
DEAD_BEFORE_S = 0.05
"""Time before the stop at which SDO stops answering, s: an answer is awaited by then."""
NEVER_S = 60.0


def stops(controlword: int) -> bool:
    """Whether a controlword ends motion or power: disable voltage, quick stop, shutdown, disable operation, or halt (CiA-402)."""
    return controlword & 0x0F != 0x0F or bool(controlword & 0x0100)


def controlword_of(cob_id: int, data: bytes, node_id: int) -> int | None:
    """The controlword that a frame carries to a node, None without one; in every RPDO of this project it comes first."""
    function = cob_id - node_id
    if function == SDO_REQUEST and len(data) == 8 and data[0] >> 5 == 1 and data[1:3] == b"\x40\x60":
        return int.from_bytes(data[4:6], "little")
    return int.from_bytes(data[:2], "little") if function in RPDOS and len(data) >= 2 else None


@dataclass(frozen=True)
class Stopped:
    """under_power: whether there was something to stop. latency_s, NEVER_S without a stop; requests: of Modbus, sent before the
    stop."""

    under_power: bool
    latency_s: float
    requests: int


class _Watch:
    """Presses the stop at a time, and records when it comes to the wire."""

    def __init__(self, stop: Stop, at_ns: int) -> None:
        self._stop, self._at_ns = stop, at_ns
        self.pressed_ns: int | None = None
        self.stopped_ns: int | None = None
        self.under_power = False
        self.requests = 0
        self.truth: Truth | None = None

    def on_bench(self, bench: Any, *, by_servo: bool) -> None:
        truth = Truth(bench)
        if self.truth is None:
            self.truth = truth
            truth.ends = self._ends_ns
            when_due(bench.clock, self._at_ns, self._press)
        if by_servo:
            for servo in [bench.servo] if isinstance(bench, Bench) else bench.servos.values():
                for order in ("quick_stop", "halt", "power_off"):
                    self._tap(servo, order)

    def _tap(self, servo: Any, order: str) -> None:
        carry_out = getattr(servo, order)

        def noted(*arguments: Any) -> None:
            self.stop_seen()
            carry_out(*arguments)

        setattr(servo, order, noted)

    def _press(self) -> None:
        assert self.truth is not None
        self.under_power = self.truth.powered
        self.pressed_ns = self.truth.clock.now_ns()
        self._stop.press()

    def _ends_ns(self) -> int | None:
        return None if self.pressed_ns is None else self.pressed_ns + round(NEVER_S * 1e9)

    def stop_seen(self) -> None:
        if self.pressed_ns is not None and self.stopped_ns is None and self.truth is not None:
            self.stopped_ns = self.truth.clock.now_ns()

    def on_can(self, peer: CanPeer, *, sdo_dead: bool) -> None:
        def heard(cob_id: int, data: bytes, _now_ns: int) -> None:
            word = controlword_of(cob_id, data, peer.node_id)
            if word is not None and stops(word):
                self.stop_seen()

        peer.foreign.on_frame = heard
        if sdo_dead:
            at_ns = max(1, self._at_ns - round(DEAD_BEFORE_S * 1e9))
            peer.arm(at_ns, lambda dead: dead.answers(lambda _data: [], SDO_ANSWER), 0)

    def on_modbus(self, peer: ModbusPeer) -> None:
        def count(_request: bytes) -> None:
            if self.pressed_ns is not None and self.stopped_ns is None:
                self.requests += 1

        peer.request = count  # type: ignore[assignment]


def stopped_at(face: str, verb: str, share: float, *, sdo_dead: bool = False) -> Stopped:
    """Run a verb and press the stop after this share of its duration."""
    stop = Stop()
    watch = _Watch(stop, max(1, round(share * undisturbed_s(face, verb) * 1e9)))
    modbus = face.startswith("modbus")
    with TemporaryDirectory() as directory, ExitStack() as stack:
        place = Place(
            Path(directory),
            face,
            Pacing(stop, 0.0),
            on_bench=lambda bench: watch.on_bench(bench, by_servo=modbus),
            on_can=lambda peer: watch.on_can(peer, sdo_dead=sdo_dead),
        )
        stack.enter_context(place.wired())
        if modbus:
            for module in (hil.machine.bench_modbus, hil.probe.wiring):
                stack.enter_context(patch.object(module, "tcp_server", behind_proxy(watch.on_modbus)))
        try:
            with ended_after(WALL_S):
                VERBS[verb](place)
        except (Exception, KeyboardInterrupt, HangError):  # noqa: BLE001 - the hostile suite judges the end
            pass
    if watch.pressed_ns is None or not watch.under_power:
        return Stopped(False, 0.0, 0)
    latency_s = NEVER_S if watch.stopped_ns is None else (watch.stopped_ns - watch.pressed_ns) * 1e-9
    return Stopped(True, latency_s, max(0, watch.requests - 1))
