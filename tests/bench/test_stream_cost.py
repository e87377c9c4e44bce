"""What streaming costs the host per axis and cycle, as a ratio to the same through the canopen package's own PDO objects.

Both run in this process in turn, over a bus that answers SYNC at once with the same frames and costs both the same. What each does:

    both    one RPDO per axis (607Ah), SYNC, one TPDO per axis (6041h, 6064h), every value packed, sent, received and unpacked
    ours    besides: mm <-> counts, travel, speed, following error and state of each axis, the time of SYNC and of each answer, missed
            cycles, late answers, a look for stray frames before SYNC, dispatch with a lock
    theirs  bare: raw values only, nothing checked, no time kept, spared the thread that would receive for it
    theirs  checked: what a user would have to add to be told the same - mm, limits, state, following error

A third is asked against the bare one, which does less than ours; the other figure is shown beside it. Reported, not judged to the
digit: what a shared host makes of a few microseconds is no property of the code. Only dearer than the bare one is a failure.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from statistics import median
from typing import Any

import can
import canopen
import pytest
from support.bench import Record, median_ratio, row, side_by_side

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.stream import CyclicStream
from drivers.clock import Clock
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_drive import EDS, CanOpenSlave
from sim_backends.servo import SimulatedServo

CYCLES = 400
ROUNDS = 25
STATUS_ENABLED = 0x1637  # operation enabled, follows the command


class LeapingClock(Clock):
    """Sleeping costs nothing."""

    def __init__(self) -> None:
        self._now_ns = 0

    def check_interrupt(self) -> None:
        return

    def now_ns(self) -> int:
        return self._now_ns

    def sleep_until_ns(self, time_ns: int) -> None:
        self._now_ns = max(self._now_ns, time_ns)


class AnsweringBus(can.BusABC):
    """Answers each SYNC with every node's TPDO, its position being the last target; other frames go to real slaves."""

    def __init__(self, node_ids: tuple[int, ...], clock: Clock) -> None:
        super().__init__(channel=None)
        self.channel_info = "answering bus"
        self._clock = clock
        self.received: deque[can.Message] = deque()
        self._answers = {
            0x200 + node_id: can.Message(
                arbitration_id=0x180 + node_id,
                data=STATUS_ENABLED.to_bytes(2, "little") + bytes(4),
                is_extended_id=False,
            )
            for node_id in node_ids
        }
        self.slaves = []
        self.streaming = False
        for node_id in node_ids:
            servo = SimulatedServo(BareShaft(), SMALL_SERVO)
            slave = CanOpenSlave(servo, node_id, self._from_slave)
            slave.boot(0)
            self.slaves.append(slave)

    def _from_slave(self, cob_id: int, data: bytes) -> None:
        self.received.append(can.Message(arbitration_id=cob_id, data=data, is_extended_id=False))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        cob_id = msg.arbitration_id
        if not self.streaming:
            for slave in self.slaves:
                slave.servo.advance(self._clock.now_ns(), 0.001)
                slave.on_frame(cob_id, bytes(msg.data), self._clock.now_ns())
        elif cob_id == 0x080:
            self.received.extend(self._answers.values())
        else:
            self._answers[cob_id].data[2:6] = msg.data

    def recv(self, timeout: float | None = None) -> can.Message | None:
        return self.received.popleft() if self.received else None


def _ours(axes: int, stack: ExitStack) -> Callable[[int], None]:
    clock = LeapingClock()
    node_ids = tuple(range(1, axes + 1))
    bus = AnsweringBus(node_ids, clock)
    link = stack.enter_context(CanLink(bus, clock))
    drives = []
    for node_id in node_ids:
        drive = CanOpenDrive(
            f"axis {node_id}",
            AxisScaling(100_000, 10.0),
            DriveLimits(-300.0, 300.0, 200.0, 2000.0),
            clock,
            link=link,
            node_id=node_id,
            settings=CanOpenSettings(heartbeat_s=None),
        )
        drive.open()
        drive.enable()
        drives.append(drive)
    stream = CyclicStream(drives, SetPointSettings(0.01))
    stream.__enter__()
    bus.streaming = True

    def run(cycles: int) -> None:
        for cycle in range(cycles):
            stream.cycle([0.001 * (cycle % 100)] * axes)
            assert abs(stream.found[0][1] - 0.001 * (cycle % 100)) < 1e-3

    return run


def _nodes(axes: int, stack: ExitStack) -> tuple[AnsweringBus, canopen.Network, list[tuple[Any, ...]]]:
    """The canopen package's own objects on a bus: of each node its RPDO, and the three mapped variables."""
    bus = AnsweringBus(tuple(range(1, axes + 1)), LeapingClock())
    bus.streaming = True
    stack.callback(bus.shutdown)
    network = canopen.Network(bus)
    nodes: list[tuple[Any, ...]] = []
    for node_id in range(1, axes + 1):
        node = network.add_node(node_id, str(EDS))
        rpdo, tpdo = node.rpdo[1], node.tpdo[1]
        for pdo, names in ((rpdo, ("Target position",)), (tpdo, ("Statusword", "Position actual value"))):
            pdo.clear()
            for name in names:
                pdo.add_variable(name)
            pdo.enabled = True
        rpdo.cob_id, tpdo.cob_id = 0x200 + node_id, 0x180 + node_id
        tpdo.subscribe()
        nodes.append((rpdo, rpdo[0], tpdo[0], tpdo[1]))
    return bus, network, nodes


def _theirs_bare(axes: int, stack: ExitStack) -> Callable[[int], None]:
    bus, network, nodes = _nodes(axes, stack)

    def run(cycles: int) -> None:
        for cycle in range(cycles):
            target = 10 * (cycle % 100)
            for rpdo, position, _, _ in nodes:
                position.raw = target
                rpdo.transmit()
            network.sync.transmit()
            while (message := bus.recv(0.0)) is not None:
                network.notify(message.arbitration_id, message.data, message.timestamp)
            feedback = [(status.raw, actual.raw) for _, _, status, actual in nodes]
            assert feedback[0] == (STATUS_ENABLED, target)

    return run


def _theirs_checked(axes: int, stack: ExitStack) -> Callable[[int], None]:
    bus, network, nodes = _nodes(axes, stack)
    counts_per_mm, step, lag = 10_000, 20_000, 10_000

    def run(cycles: int) -> None:
        sent = [0] * axes
        for cycle in range(cycles):
            targets_mm = [0.001 * (cycle % 100)] * axes
            planned = []
            for target_mm, before in zip(targets_mm, sent, strict=True):
                counts = round(target_mm * counts_per_mm)
                if not -300.0 <= target_mm <= 300.0 or abs(counts - before) > step:
                    pytest.fail("outside")
                planned.append(counts)
            sent = planned
            for (rpdo, position, _, _), counts in zip(nodes, planned, strict=True):
                position.raw = counts
                rpdo.transmit()
            network.sync.transmit()
            while (message := bus.recv(0.0)) is not None:
                network.notify(message.arbitration_id, message.data, message.timestamp)
            feedback = []
            for (_, _, status, actual), counts in zip(nodes, planned, strict=True):
                word, place = status.raw, actual.raw
                if word & 0x106F != 0x1027 or abs(place - counts) > lag:
                    pytest.fail("does not follow")
                feedback.append((word, place / counts_per_mm))
            assert abs(feedback[0][1] - targets_mm[0]) < 1e-3

    return run


@pytest.mark.parametrize("axes", [1, 2, 5])
def test_cost_of_streaming(axes: int, record_property: Record) -> None:
    with ExitStack() as stack:
        runs = [partial(side(axes, stack), CYCLES) for side in (_ours, _theirs_bare, _theirs_checked)]
        mine, bare, checked = side_by_side(runs, ROUNDS)
    us = [1e6 * median(times) / CYCLES / axes for times in (mine, bare, checked)]
    for other_us, other, name, asked in (
        (us[1], bare, "canopen's own PDO objects", "≤ 0.333"),
        (us[2], checked, "the same with a user's checks", ""),
    ):
        row(
            record_property,
            f"streaming, {axes} ax{'i' if axes == 1 else 'e'}s, per axis and cycle",
            us[0],
            other_us,
            "µs",
            beside=name,
            ratio=median_ratio(mine, other),
            asked=asked,
        )
    assert median_ratio(mine, bare) < 1.0
