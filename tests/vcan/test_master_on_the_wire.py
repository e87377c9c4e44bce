"""What our master really puts on the bus, as candump saw it: the orders that CiA 301 and CiA 402 prescribe, byte for byte."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from support.candump import Seen, candump
from support.served_drive import served

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.clock import WallClock
from drivers.drive import ServoDrive
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.servo import SimulatedServo

pytestmark = pytest.mark.vcan

BUS = "vcan0"
NODE = 5
COUNTS_PER_MM = 10_000


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


@pytest.fixture
def seen(stack: ExitStack, tmp_path: Path) -> Seen:
    return stack.enter_context(candump(BUS, tmp_path))


@pytest.fixture
def drive(stack: ExitStack, seen: Seen) -> CanOpenDrive:
    del seen  # listens first
    clock = WallClock()
    servo = SimulatedServo(BareShaft(), SMALL_SERVO)
    stack.enter_context(served(servo, clock, interface="socketcan", channel=BUS, node_id=NODE, step_s=0.005))
    link = stack.enter_context(CanLink.open(clock, interface="socketcan", channel=BUS))
    limits = DriveLimits(-300.0, 300.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
    settings = CanOpenSettings(sdo_timeout_s=10.0, sample_timeout_s=5.0, mode_timeout_s=10.0, heartbeat_s=2.0)
    return CanOpenDrive("X", AxisScaling(100_000, 10.0), limits, clock, link=link, node_id=NODE, settings=settings)


def written(frames: list[str], index: int, subindex: int = 0) -> list[int]:
    """Values that SDO downloads (expedited, size shown: 2Fh, 2Bh, 23h) gave an object, in their order."""
    mux = index.to_bytes(2, "little").hex().upper() + f"{subindex:02X}"
    sizes = {"2F": 1, "2B": 2, "23": 4}
    return [
        int.from_bytes(bytes.fromhex(data[8:])[: sizes[data[:2]]], "little", signed=index == 0x607A)
        for data in (frame.removeprefix(f"{0x600 + NODE:03X}#") for frame in frames)
        if data[:2] in sizes and data[2:8] == mux
    ]


def controlwords(frames: list[str]) -> list[int]:
    """Every controlword, by SDO or in the first word of RPDO 1, without repetitions in a row."""
    words: list[int] = []
    for frame in frames:
        found = written([frame], 0x6040)
        if frame.startswith(f"{0x200 + NODE:03X}#"):
            found = [int.from_bytes(bytes.fromhex(frame[4:8]), "little")]
        words += [word for word in found if not words or words[-1] != word]
    return words


def first(frames: list[str], start: str) -> int:
    return next(place for place, frame in enumerate(frames) if frame.startswith(start))


def test_a_pdo_is_disabled_cleared_mapped_set_and_enabled_in_this_order(drive: CanOpenDrive, seen: Seen) -> None:
    with drive:
        frames = [frame for frame in seen() if frame.startswith("605#2")]
    order = [
        "605#23001801850100C0",  # 1800h:01 = C0000185h: TPDO 1 does not exist
        "605#2F001A0000000000",  # 1A00h:00 = 0
        "605#23001A0110004160",  # 1A00h:01 = 60410010h: statusword
        "605#23001A0220006460",  # 1A00h:02 = 60640020h: position actual value
        "605#2F001A00",  # 1A00h:00 = number of objects
        "605#2F00180201000000",  # 1800h:02 = 1: with each SYNC
        "605#2300180185010040",  # 1800h:01 = 40000185h: exists, no RTR
    ]
    places = [first(frames, order[0])]
    for start in order[1:]:
        places.append(places[-1] + 1 + first(frames[places[-1] + 1 :], start))
    assert places == sorted(places)
    assert "000#0105" in seen(), "NMT start of node 5"


def test_enabling_takes_the_present_place_for_the_target_first_and_starts_no_move(
    drive: CanOpenDrive, seen: Seen
) -> None:
    with drive:
        drive.enable()
        drive.start_move(1.5, 20.0)
        arrive(drive)
        drive.disable()
        before = len(seen())
        drive.enable()
        frames = seen()[before:]
    assert controlwords(frames) == [0x0006, 0x0007, 0x000F]  # shutdown, switch on, enable operation; bit 4 never
    targets = written(frames, 0x607A)
    assert targets[-1] == pytest.approx(1.5 * COUNTS_PER_MM, abs=20)
    assert first(frames, "605#237A6000") < first(frames, "605#2B4060000F00")


def test_a_set_point_is_handed_over_by_its_handshake(drive: CanOpenDrive, seen: Seen) -> None:
    with drive:
        drive.enable()
        before = len(seen())
        drive.start_move(-1.0, 20.0)
        frames = seen()[before:]
        arrive(drive)
    assert written(frames, 0x607A) == [-10_000]
    assert written(frames, 0x6081) == [200_000]  # 20 mm/s in counts/s
    rising = first(frames, "605#2B4060003F00")  # new set-point, change at once
    assert first(frames, "605#237A6000F0D8FFFF") < rising
    assert controlwords(frames)[-2:] == [0x003F, 0x000F]  # and taken back once acknowledged


def test_quick_stop_is_controlword_2(drive: CanOpenDrive, seen: Seen) -> None:
    with drive:
        drive.enable()
        drive.start_move(50.0, 20.0)
        before = len(seen())
        drive.quick_stop()
        assert controlwords(seen()[before:])[0] == 0x0002


def arrive(drive: ServoDrive) -> None:
    drive.wait_for(lambda sample: sample.target_reached, 30.0, "arrived")
