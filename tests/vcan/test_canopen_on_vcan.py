"""The drive layer where only a kernel can prove it: SYNC and heartbeat from the broadcast manager, frames as candump sees them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from support.candump import candump
from support.served_drive import served

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.clock import WallClock
from drivers.drive import DriveState
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.servo import SimulatedServo

pytestmark = pytest.mark.vcan

NODE = 5
LIMITS = DriveLimits(-300.0, 300.0, 200.0, 2000.0)
Until = Callable[[Callable[[], bool], str], None]


@pytest.fixture
def slave() -> Iterator[CanOpenSlave]:
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    with served(servo, WallClock(), interface="socketcan", channel="vcan0", node_id=NODE, step_s=0.005) as slave:
        yield slave


def _drive(link: CanLink, **settings: object) -> CanOpenDrive:
    how = CanOpenSettings(sdo_timeout_s=2.0, sample_timeout_s=1.0, heartbeat_s=None, **settings)  # type: ignore[arg-type]
    return CanOpenDrive("X", AxisScaling(100_000, 10.0), LIMITS, link.clock, link=link, node_id=NODE, settings=how)


def test_an_axis_stops_when_its_master_is_gone(slave: CanOpenSlave, until: Until) -> None:
    """The kernel sends our heartbeat; when the socket is closed nobody does, and the drive stops by itself."""
    with CanLink.open(WallClock(), interface="socketcan", channel="vcan0") as link:
        drive = _drive(link, guard_s=1.0)
        drive.open()
        drive.enable()
        drive.start_move(250.0, 10.0)
        assert drive.sample().state is DriveState.ENABLED
    until(lambda: slave.profile.state is not DriveState.ENABLED, "the drive misses our heartbeat")
    until(lambda: slave.servo.velocity_actual_counts_s == 0, "the axis is at rest")
    assert slave.servo.motor_rev * 10.0 < 200.0
    drive.close()


def test_candump_shows_the_frames_that_the_standard_has(slave: CanOpenSlave, tmp_path: Path) -> None:
    with (
        CanLink.open(WallClock(), interface="socketcan", channel="vcan0") as link,
        _drive(link) as drive,
        candump("vcan0", tmp_path) as seen,
    ):
        drive.enable()
        drive.sample()
        frames = seen()
    writes = [frame for frame in frames if frame.startswith(("605#2", "605#3"))]
    assert writes == [
        "605#2F60600001000000",
        "605#2B40600006000000",
        "605#2B40600007000000",
        "605#237A600000000000",
        "605#23FF600000000000",
        "605#2B71600000000000",
        "605#2B4060000F000000",
    ]
    after = frames[frames.index("605#2B40600006000000") :]
    assert next(frame for frame in after if frame.startswith("585#")) == "585#6040600000000000"
    assert "080#" in frames
    assert any(frame.startswith("185#") for frame in frames), "the TPDO"
    assert slave.profile.state is not DriveState.FAULT
