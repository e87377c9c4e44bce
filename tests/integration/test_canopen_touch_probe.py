"""Positions latched by the drive: exact however fast the axis passes and however late the host asks."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.errors import AbortError, InputError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.touch_probe import Edge, Latch
from sim_backends.canopen_drive import CanOpenSlave

NODE = 5
LIMITS = DriveLimits(-200.0, 200.0, 200.0, 2000.0)
COUNTS_PER_MM = 10_000


class Rig:
    def __init__(self, stack: ExitStack, direction: int = 1) -> None:
        self.bench = CanBench((NODE,))
        link = stack.enter_context(CanLink(self.bench.port(), self.bench.clock))
        scaling = AxisScaling(100_000, 10.0, direction=direction)
        self.drive = stack.enter_context(CanOpenDrive("X", scaling, LIMITS, self.bench.clock, link=link, node_id=NODE))
        self.drive.enable()
        self.probe = self.drive.touch_probe()

    @property
    def slave(self) -> CanOpenSlave:
        return self.bench.slave

    def go(self, target_mm: float, velocity_mm_s: float) -> list[Latch]:
        """Move and arrive; only then look at the probe."""
        self.drive.start_move(target_mm, velocity_mm_s)
        self.drive.wait_for(lambda sample: sample.target_reached, 60.0, "arrived")
        return self.probe.poll()


@pytest.fixture(params=[1, -1], ids=["direct", "reversed"])
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    with ExitStack() as stack:
        rig = Rig(stack, request.param)
        face = 31.4159
        # the probe touches from face mm of the load on
        rig.slave.profile.probe.attach(1, lambda counts: counts * request.param / COUNTS_PER_MM >= face)
        rig.slave.profile.probe.attach(2, lambda counts: 40.0 <= counts * request.param / COUNTS_PER_MM < 41.0)
        yield rig


@pytest.mark.parametrize("velocity_mm_s", [0.5, 20.0, 200.0])
def test_the_latch_is_exact_at_any_speed(rig: Rig, velocity_mm_s: float) -> None:
    rig.go(30.0, 200.0)
    rig.probe.arm(1, [Edge.POSITIVE])
    assert rig.probe.poll() == []
    (latch,) = rig.go(33.0, velocity_mm_s)
    assert (latch.probe, latch.edge) == (1, Edge.POSITIVE)
    assert latch.position_load_mm == pytest.approx(31.4159, abs=1.01 / COUNTS_PER_MM)
    assert latch.edges == 1
    assert latch.device_stamp is not None
    assert latch.device_stamp * 1000 <= latch.time_ns


def test_a_single_latch_keeps_the_first_edge(rig: Rig) -> None:
    rig.probe.arm(2, [Edge.POSITIVE])
    (first,) = rig.go(60.0, 100.0)
    assert first.position_load_mm == pytest.approx(40.0, abs=1e-3)
    assert rig.go(0.0, 100.0) == []  # met again from the other side, at 41
    rig.probe.arm(2, [Edge.POSITIVE])
    rig.go(60.0, 100.0)
    rig.probe.arm(2, [Edge.POSITIVE])
    (again,) = rig.go(0.0, 100.0)
    assert again.position_load_mm == pytest.approx(41.0, abs=1e-3)


def test_one_probe_is_armed_without_disturbing_the_other(rig: Rig) -> None:
    rig.probe.arm(1, [Edge.POSITIVE])
    rig.go(35.0, 100.0)
    rig.probe.arm(2, [Edge.POSITIVE])
    rig.probe.disarm(2)
    assert rig.slave.dictionary.number(0x60B8) == 0x0011
    assert rig.slave.dictionary.number(0x60B9) == 0x0003


def test_what_cannot_be_is_refused(rig: Rig) -> None:
    with pytest.raises(InputError, match="expected probe 1 or 2"):
        rig.probe.arm(3, [Edge.POSITIVE])
    with pytest.raises(InputError, match="at least one edge"):
        rig.probe.arm(1, [])
    with pytest.raises(AbortError, match="60B8h:00 refused: invalid value"):
        rig.drive.sdo.write_bytes(0x60B8, 0, b"\x05\x00")  # zero pulse as source
