"""CanOpenDrive beyond the contract: what is particular to CiA-402, against the simulated drive in simulated time."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import can
import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.canopen.eds import load_eds
from drivers.canopen.raw_parameters import CanOpenRawParameters
from drivers.canopen.side_by_side import CanLine
from drivers.cia402.modes import Mode
from drivers.cia402.power import PowerTimes
from drivers.drive import Capability, DriveState, DriveZero
from drivers.errors import (
    CapabilityError,
    DriveFaultError,
    InputError,
    LimitError,
    LinkLostError,
    MotionTimeoutError,
    NoAnswerError,
    ProtocolError,
    StateError,
)
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from sim_backends.bare_shaft import SMALL_SERVO
from sim_backends.canopen_drive import EDS
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind

NODE = 5
LIMITS = DriveLimits(-200.0, 200.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
K = CanFaultKind


class Rig:
    """A bench with one drive on it."""

    def __init__(
        self,
        *faults: CanFault,
        parameters: dict[tuple[int, int], int] | None = None,
        lacking: Sequence[int] = (),
        refused: Sequence[tuple[int, int]] = (),
        **settings: object,
    ) -> None:
        servo = replace(SMALL_SERVO, coast_rev_s2=300.0)
        self.bench = CanBench(
            (NODE,),
            faults={NODE: faults},
            parameters=parameters or {},
            servo_parameters=servo,
            lacking=lacking,
            refused=refused,
        )
        self.stack = ExitStack()
        self.link = self.stack.enter_context(CanLink(self.bench.port(), self.bench.clock))
        self.drive = CanOpenDrive(
            "X",
            AxisScaling(100_000, 10.0),
            LIMITS,
            self.bench.clock,
            link=self.link,
            node_id=NODE,
            settings=CanOpenSettings(**settings),  # type: ignore[arg-type]
        )

    def opened(self) -> CanOpenDrive:
        self.drive.open()
        self.stack.callback(self.drive.close)
        return self.drive

    def enabled(self) -> CanOpenDrive:
        drive = self.opened()
        drive.enable()
        return drive

    def run(self, seconds: float) -> None:
        self.bench.clock.sleep_s(seconds)

    def number(self, index: int, subindex: int = 0) -> int:
        return self.bench.slave.dictionary.number(index, subindex)


MakeRig = Callable[..., Rig]


def shows(rig: Rig, change: Callable[[int], int]) -> None:
    """From its opening on the drive shows its statusword changed so."""
    status = rig.bench.slave.dictionary.reader(0x6041, 0)
    rig.bench.slave.dictionary.on_read(0x6041, 0, lambda: change(status()))


@pytest.fixture
def make() -> Iterator[MakeRig]:
    with ExitStack() as stack:

        def build(*faults: CanFault, **how: object) -> Rig:
            rig = Rig(*faults, **how)  # type: ignore[arg-type]
            stack.push(rig.stack)
            return rig

        yield build


# -- opening -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("counts_per_rev", "direction", "limits_mm", "home_mm"),
    [
        (2**23, 1, (0.0, 3000.0), None),
        (2**23, -1, (-2561.0, 0.0), None),
        (2**26, 1, (-300.0, 321.0), None),
        (100_000, 1, (0.0, 100.0), 220_000.0),
    ],
)
def test_a_travel_that_32_bits_do_not_hold_is_refused_before_a_frame(
    make: MakeRig, counts_per_rev: int, direction: int, limits_mm: tuple[float, float], home_mm: float | None
) -> None:
    rig = make(homing=HomingSettings(home_position_mm=home_mm))
    rig.drive.scaling = AxisScaling(counts_per_rev, 10.0, direction=direction)
    rig.drive.limits = DriveLimits(*limits_mm, 200.0, 2000.0)
    with pytest.raises(InputError, match=r"the drive holds positions from -\d+ to \d+ mm"):
        rig.drive.open()
    assert rig.drive.identity is None


def test_a_node_that_another_master_stopped_is_told_from_one_that_is_dead(make: MakeRig) -> None:
    """CiA-301, 7.3.2.2.4: stopped, a node takes part in NMT and heartbeat alone."""
    rig = make(parameters={(0x1017, 0): 100})
    rig.link.send(0x000, bytes((0x02, NODE)))
    rig.run(0.5)
    with pytest.raises(NoAnswerError, match="heartbeat says NMT stopped"):
        rig.drive.open()
    rig.link.send(0x000, bytes((0x01, NODE)))
    assert rig.opened().identity is not None
    with pytest.raises(NoAnswerError) as silent:
        make(CanFault(K.SDO_LOST)).drive.open()
    assert "NMT" not in str(silent.value)


def test_identity_and_capabilities(make: MakeRig) -> None:
    drive = make().opened()
    assert drive.identity is not None
    assert (drive.identity.vendor_id, drive.identity.product_code) == (0x4E1, 0x402)
    assert [drive.fault_text(code) for code in (0x8611, 0x3220, 0xFF01)] == [
        "following error (8611h)",
        "DC link under-voltage (3220h)",
        "device specific (FF01h)",
    ]
    assert drive.capabilities == frozenset(Capability)


def test_modes_that_6502h_does_not_list_are_not_offered(make: MakeRig) -> None:
    drive = make(parameters={(0x6502, 0): 0x01}).opened()
    assert Capability.HOMING not in drive.capabilities
    drive.enable()
    with pytest.raises(CapabilityError, match="homing"):
        drive.start_homing()
    with pytest.raises(CapabilityError, match="no mode cyclic_position"):
        drive.set_mode(Mode.CYCLIC_POSITION)


def test_a_device_of_another_profile_is_refused(make: MakeRig) -> None:
    rig = make(parameters={(0x1000, 0): 0x000F0191})
    with pytest.raises(ProtocolError, match="device profile 401, not 402"):
        rig.drive.open()


def test_a_whole_job_leaves_every_parameter_as_it_was(make: MakeRig) -> None:
    rig = make(guard_s=0.2, homing=HomingSettings(method=37))
    dictionary = rig.bench.slave.dictionary
    shown = {0x1003, 0x6040, 0x607A}  # what happened and what was commanded last, no parameters

    def image() -> dict[tuple[int, int], bytes]:
        return {
            (index, subindex): dictionary.raw((index, subindex))
            for index, subindex in dictionary.items
            if index not in shown
            and not (0x1600 <= index < 0x1C00 and index & 0x200 and subindex > dictionary.number(index, 0))
        }

    before = image()
    with rig.drive as drive:
        drive.enable()
        drive.home(5.0)
        drive.start_move(20.0, 50.0)
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        assert image() != before
    assert image() == before


def test_opening_writes_no_motion_parameter(make: MakeRig) -> None:
    rig = make()
    written: set[int] = set()
    spy = rig.bench.wire.add_node()

    def see(cob_id: int, data: bytes, _now_ns: int) -> None:
        if cob_id == 0x605 and data[0] >> 5 == 1:
            written.add(int.from_bytes(data[1:3], "little"))

    spy.on_frame = see
    rig.drive.open()
    assert {index for index in written if index >= 0x6000} == set()
    spy.on_frame = lambda *_: None
    rig.drive.close()


def test_a_failed_opening_puts_everything_back(make: MakeRig) -> None:
    rig = make(CanFault(K.TPDO_LOST, duration_s=10.0))
    before = rig.number(0x1017), rig.number(0x1800, 1), rig.number(0x1A00, 0)
    with pytest.raises(NoAnswerError, match="SYNC"):
        rig.drive.open()
    assert (rig.number(0x1017), rig.number(0x1800, 1), rig.number(0x1A00, 0)) == before
    with pytest.raises(StateError, match="not open"):
        rig.drive.sample()


def test_a_weak_quick_stop_is_pointed_out(make: MakeRig) -> None:
    drive = make(parameters={(0x6085, 0): 1_000_000}).opened()
    assert drive.notes == [
        "drive X: quick stop (6085h) brakes with 100 mm/s², moves with up to 2000 mm/s²: a stop may overshoot the target"
    ]


# -- enabling ------------------------------------------------------------------------------------------------------------


def test_a_brake_that_takes_its_time(make: MakeRig) -> None:
    rig = make(power=PowerTimes(enable_s=1.0))
    rig.bench.slave.profile.brake_delay_ns = 600_000_000
    drive = rig.enabled()
    assert drive.sample().state is DriveState.ENABLED
    assert rig.bench.clock.now_ns() >= 600_000_000


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (K.BRAKE_STUCK, r"not enabled within 0.5 s, it stays in switched on .*brake"),
        (K.SAFE_TORQUE_OFF, r"stays in switch on disabled .*safe torque off \(STO\) is active"),
        (K.LOCAL_CONTROL, "remote bit 9 is 0"),
    ],
)
def test_what_keeps_a_drive_from_being_enabled_is_named(make: MakeRig, fault: CanFaultKind, words: str) -> None:
    drive = make(CanFault(fault), power=PowerTimes(enable_s=0.5)).opened()
    with pytest.raises(MotionTimeoutError, match=words):
        drive.enable()


# -- quick stop endings ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("option", range(9))
def test_quick_stop_ends_as_605ah_says(make: MakeRig, option: int) -> None:
    rig = make(parameters={(0x605A, 0): option})
    drive = rig.enabled()
    drive.start_move(150.0, 100.0)
    rig.run(0.5)
    drive.quick_stop()
    rig.run(1.0)
    sample = drive.sample()
    assert sample.velocity_mm_s == 0.0
    stays = option >= 5
    assert sample.state is (DriveState.QUICK_STOP if stays else DriveState.SWITCH_ON_DISABLED)
    assert rig.bench.servo.powered is stays
    place_mm = sample.position_load_mm
    drive.enable()  # out of quick stop (16) without ever letting go, or from the bottom
    rig.run(0.2)
    assert drive.sample().state is DriveState.ENABLED
    assert drive.sample().position_load_mm == pytest.approx(place_mm, abs=1e-3)
    drive.start_move(0.0, 100.0)
    drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")


def test_an_axis_that_holds_after_quick_stop_is_enabled_without_being_let_go(make: MakeRig) -> None:
    rig = make(parameters={(0x605A, 0): 6})
    drive = rig.enabled()
    drive.quick_stop()
    rig.run(0.1)
    powered: list[bool] = []
    rig.bench.clock.attach(lambda _now_ns, _dt_s: powered.append(rig.bench.servo.powered))
    drive.enable()
    rig.run(0.1)
    assert powered
    assert all(powered)


# -- profile moves -----------------------------------------------------------------------------------------------------------


# -- homing ---------------------------------------------------------------------------------------------------------------


def test_homing_settings_are_written_in_the_drives_units(make: MakeRig) -> None:
    rig = make(homing=HomingSettings(method=17, speed_switch_mm_s=40.0, speed_zero_mm_s=2.0, home_position_mm=-310.0))
    drive = rig.enabled()
    drive.start_homing()
    assert drive.sample().homed is False
    drive.wait_for(lambda sample: sample.homed is True, 60.0, "homed")
    assert (rig.number(0x6098), rig.number(0x6099, 1), rig.number(0x6099, 2)) == (17, 400_000, 20_000)
    assert rig.number(0x607C) == -3_100_000
    drive.start_move(0.0, 200.0)
    drive.wait_for(lambda sample: sample.target_reached, 10.0, "arrived")
    # the switch is at -32 rev = -320 mm of the shaft, and now shows -310
    assert rig.bench.servo.motor_rev * 10.0 == pytest.approx(-10.0, abs=0.02)


def test_a_homing_that_fails_is_not_tried_again(make: MakeRig) -> None:
    rig = make(homing=HomingSettings(method=-4))  # allowed by the dictionary, unknown to the motor
    drive = rig.enabled()
    begun: list[int] = []
    rig.bench.slave.dictionary.on_write(0x6040, 0, lambda word: begun.append(word) if word & 0x10 else None)
    with pytest.raises(DriveFaultError, match="homing failed"):
        drive.home(5.0)
    assert len(begun) == 1
    assert drive.sample().state is DriveState.ENABLED


def test_what_the_zero_rests_on_is_the_axis_files_or_the_drives(make: MakeRig) -> None:
    of_drive = make(parameters={(0x6098, 0): 17, (0x607C, 0): -3_100_000, (0x1018, 4): 77}).opened()
    assert of_drive.zero() == DriveZero(17, -310.0, {"vendor": 0x4E1, "product": 0x402, "serial": 77})
    of_file = make(homing=HomingSettings(method=1, home_position_mm=2.0)).opened().zero()
    assert (of_file.method, of_file.home_position_mm) == (1, 2.0)


@pytest.mark.parametrize(("shown", "says"), [(0x1400, True), (0x1000, None), (0x0400, None), (0x3400, None)])
def test_a_drive_is_asked_in_homing_mode_whether_it_has_kept_its_zero(
    make: MakeRig, shown: int, says: bool | None
) -> None:
    """Bit 12 with bit 10 and without 13; in any other mode bit 12 means something else."""
    rig = make(homing=HomingSettings(method=37))
    drive = rig.opened()
    dictionary = rig.bench.slave.dictionary
    mode, status = dictionary.reader(0x6061, 0), dictionary.reader(0x6041, 0)
    dictionary.on_read(0x6041, 0, lambda: status() & ~0x3400 | (shown if mode() == Mode.HOMING else 0x1400))
    assert drive.says_homed() is says
    assert drive.sample().homed is says
    assert drive.sample().state is DriveState.SWITCH_ON_DISABLED
    drive.close()
    assert rig.number(0x6060) == 0  # as it was found


def test_the_mode_of_an_enabled_axis_is_not_changed_to_ask(make: MakeRig) -> None:
    rig = make(homing=HomingSettings(method=37))
    drive = rig.enabled()
    assert drive.says_homed() is None
    assert rig.number(0x6061) == Mode.PROFILE_POSITION


def test_a_homing_that_is_refused_is_not_ordered(make: MakeRig) -> None:
    rig = make(homing=HomingSettings(method=37))
    drive = rig.enabled()
    begun: list[int] = []
    rig.bench.slave.dictionary.on_write(0x6040, 0, lambda word: begun.append(word) if word & 0x10 else None)

    def refuse() -> None:
        raise StateError("the zero would be lost")

    drive.before_homing = refuse
    for home in (drive.start_homing, lambda: drive.home(5.0)):
        with pytest.raises(StateError, match="would be lost"):
            home()
    assert not begun


def _other_sign(offset: int) -> int:
    return -offset


def _ignored(_offset: int) -> int:
    return 0


def _other_unit(offset: int) -> int:
    return 10 * offset


def _as_announced(offset: int) -> int:
    return offset


@pytest.mark.parametrize(("method", "home_mm"), [(37, -5.0), (35, 120.0), (17, 0.9), (1, -5.0)])
@pytest.mark.parametrize("taken", [_as_announced, _other_sign, _ignored, _other_unit])
def test_the_place_after_a_homing_is_the_one_announced(
    make: MakeRig, method: int, home_mm: float, taken: Callable[[int], int]
) -> None:
    """Elmo, Parker and Applied Motion define the zero as home + 607Ch, so that home shows -607Ch; others show 607Ch there."""
    rig = make(
        homing=HomingSettings(method, speed_switch_mm_s=100.0, speed_zero_mm_s=5.0, home_position_mm=home_mm),
        parameters={(0x609A, 0): 2_000_000},
    )
    servo = rig.bench.servo
    plain = servo.start_homing
    servo.start_homing = lambda how, fast, slow, offset: plain(how, fast, slow, taken(offset))  # type: ignore[method-assign]
    drive = rig.enabled()
    if taken is _as_announced:
        assert drive.home(60.0).position_load_mm == pytest.approx(home_mm, abs=0.3)
        return
    with pytest.raises(ProtocolError, match=rf"was to show {home_mm:g} mm and shows") as caught:
        drive.home(60.0)
    assert ("the other sign" in str(caught.value)) is (taken is _other_sign)
    rig.run(0.5)
    assert drive.sample().homed is False
    assert servo.velocity_actual_counts_s == 0


def test_an_offset_shorter_than_the_way_to_rest_has_no_sign(make: MakeRig) -> None:
    """An offset of 0.02 mm and a stop of 0.3 mm behind the switch: which sign it has cannot be seen."""
    for home_mm in (0.02, -0.02, 0.0):
        rig = make(
            homing=HomingSettings(17, speed_switch_mm_s=50.0, speed_zero_mm_s=10.0, home_position_mm=home_mm),
            parameters={(0x609A, 0): 2_000_000},
        )
        assert rig.enabled().home(60.0).homed is True


def test_a_homing_that_does_not_end_is_stopped(make: MakeRig) -> None:
    rig = make(homing=HomingSettings(method=17, speed_switch_mm_s=1.0))
    drive = rig.enabled()
    with pytest.raises(MotionTimeoutError, match="homed not within 1 s"):
        drive.home(1.0)
    rig.run(0.5)
    assert rig.bench.servo.velocity_actual_counts_s == 0


def test_a_target_that_the_drive_would_clip_is_refused(make: MakeRig) -> None:
    rig = make(parameters={(0x607D, 1): -500_000, (0x607D, 2): 500_000})
    drive = rig.enabled()
    with pytest.raises(
        LimitError, match=r"limits the target 1000000 to its own software limits \(607Dh\) -500000 to 500000"
    ):
        drive.start_move(100.0, 50.0)
    rig.run(0.5)
    assert drive.sample().velocity_mm_s == 0.0
    assert drive.sample().position_load_mm < 1.0
    drive.start_move(20.0, 50.0)
    drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")


def _always_in_position(word: int, _since_s: float) -> int:
    return word | 0x0400


def _in_position_goes_late(word: int, since_s: float) -> int:
    return word | (0x0400 if since_s < 0.2 else 0)


@pytest.mark.parametrize("modes", [0x3FF, 0x0A0], ids=["profile position", "set-points only"])
@pytest.mark.parametrize("shown", [_always_in_position, _in_position_goes_late])
@pytest.mark.parametrize("window", [10, 2_000_000, 0x3FFF_FFFF, 0xFFFF_FFFF, 0x7FFF_FFFF])
def test_no_window_is_not_one_of_all_positions(
    make: MakeRig, window: int, shown: Callable[[int, float], int], modes: int
) -> None:
    """6067h = FFFFFFFFh switches the window off (CiA 402-2; as delivered of EPOS4 and TMCM); Leadshine's 2CS3E shows bit 10 always."""
    rig = make(
        parameters={(0x6067, 0): window, (0x6502, 0): modes}, homing=HomingSettings(method=37, home_position_mm=0.0)
    )
    clock = rig.bench.clock
    begun_ns = clock.now_ns()
    shows(rig, lambda word: shown(word, (clock.now_ns() - begun_ns) / 1e9))
    drive = rig.enabled()
    for target_mm in (30.0, 29.0):
        begun_ns = clock.now_ns()
        drive.start_move(target_mm, 50.0)
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        within_mm = (
            0.006 if window in (10, 0xFFFF_FFFF, 0x7FFF_FFFF) else 0.02
        )  # a drive rests anywhere in a window that it has
        assert rig.bench.servo.position_actual_counts / 10_000 == pytest.approx(target_mm, abs=within_mm)
    drive.start_homing()  # which the move before must not end, nor keep from ending
    drive.wait_for(lambda sample: sample.homed is True and sample.target_reached, 2.0, "homed")
    assert drive.sample().position_load_mm == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("limits", "home_offset"),
    [((-(2**31), 2**31 - 1), 0), ((0, 0), 0), ((-100, 100_100), 0), ((-60_000, 200_000), -50_000)],
    ids=["wide", "none", "just beyond", "shifted by 607Ch"],
)
def test_bit_11_by_the_current_ends_no_move(make: MakeRig, limits: tuple[int, int], home_offset: int) -> None:
    """ros_canopen PR 461, maxon_epos4_ros1 issue 3: a drive shows bit 11 while its current saturates."""
    rig = make(parameters={(0x607D, 1): limits[0], (0x607D, 2): limits[1], (0x607C, 0): home_offset})
    shows(rig, lambda word: word | (0x0800 if rig.bench.servo.velocity_actual_counts_s else 0))
    drive = rig.enabled()
    for target_mm in (10.0, 5.0):
        drive.start_move(target_mm, 50.0)
        limited = drive.wait_for(lambda sample: sample.position_load_mm > 5.5, 2.0, "half way").limited
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
        assert drive.sample().position_load_mm == pytest.approx(target_mm, abs=1e-3)
    assert limited
    assert len([note for note in drive.notes if "bit 11" in note]) == 1


@pytest.mark.parametrize(("lacking", "beyond_mm"), [(1, 60.0), (2, -60.0)])
def test_one_bound_of_607d_leaves_the_other_side_open(make: MakeRig, lacking: int, beyond_mm: float) -> None:
    rig = make(parameters={(0x607D, 1): -500_000, (0x607D, 2): 500_000})
    profile, items = rig.bench.slave.profile, rig.bench.slave.dictionary.items
    clamp = profile._clamp
    shows(rig, lambda word: word | 0x0800)
    drive = rig.enabled()
    profile._clamp = lambda target: target  # type: ignore[method-assign]
    del items[0x607D, lacking]
    drive.start_move(-beyond_mm, 100.0)
    drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
    with pytest.raises(LimitError, match=r"own software limits \(607Dh\)"):
        drive.start_move(beyond_mm, 100.0)
    profile._clamp = clamp  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("later", "target_mm", "home_offset"), [(False, 60.0, 0), (True, 60.0, 0), (False, 45.0, 100_000)]
)
def test_bit_11_by_the_current_hides_no_limit(make: MakeRig, later: bool, target_mm: float, home_offset: int) -> None:
    rig = make(parameters={(0x607D, 1): -500_000, (0x607D, 2): 500_000, (0x607C, 0): home_offset})
    servo = rig.bench.servo
    shows(
        rig, lambda word: word & ~0x0800 | (0x0800 if not later or abs(servo.position_actual_counts) > 100_000 else 0)
    )
    drive = rig.enabled()
    with pytest.raises(LimitError, match=r"limits the target \d+ to its own software limits \(607Dh\)"):  # noqa: PT012
        drive.start_move(target_mm, 50.0)
        drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
    rig.run(0.5)
    assert drive.sample().velocity_mm_s == 0.0
    assert servo.position_actual_counts < 150_000


def test_the_dictionary_file_is_asked_before_mapping(make: MakeRig, tmp_path: Path) -> None:
    text = EDS.read_text(encoding="utf-8").replace(
        "ParameterName=Torque actual value\nObjectType=0x7\nDataType=0x0003\nAccessType=ro\nPDOMapping=1",
        "ParameterName=Torque actual value\nObjectType=0x7\nDataType=0x0003\nAccessType=ro\nPDOMapping=0",
    )
    path = tmp_path / "drive.eds"
    path.write_text(text, encoding="utf-8")
    rig = make()
    rig.drive.node.eds = load_eds(path, NODE)
    with pytest.raises(InputError, match="6077h:00 torque actual value cannot be mapped"):
        rig.drive.open()
    rig.drive.node.eds = load_eds(EDS, NODE)
    rig.opened()


def test_the_end_of_the_last_homing_is_not_believed(make: MakeRig) -> None:
    """The drive shows the statusword of before for 4 ms after the start."""
    rig = make(homing=HomingSettings(method=1, speed_switch_mm_s=100.0, speed_zero_mm_s=5.0))
    kept, fresh_ns = 0, 0
    shows(rig, lambda word: kept if rig.bench.clock.now_ns() < fresh_ns else word)
    drive = rig.enabled()
    drive.home(60.0)
    kept = rig.bench.slave.profile.statusword()
    drive.start_homing()
    fresh_ns = rig.bench.clock.now_ns() + 4_000_000
    assert drive.sample().homed is False
    assert drive.sample().target_reached is False
    rig.run(0.2)
    assert drive.sample().homed is False
    assert rig.bench.servo.velocity_actual_counts_s != 0
    assert drive.wait_for(lambda sample: sample.homed is True, 60.0, "homed").target_reached
    assert rig.bench.servo.velocity_actual_counts_s == 0
    assert drive.sample().state is DriveState.ENABLED


def test_a_homing_that_was_over_before_anybody_looked_counts_after_a_while_at_rest(make: MakeRig) -> None:
    rig = make(homing=HomingSettings(method=37, home_position_mm=12.0))
    drive = rig.enabled()
    drive.home(5.0)
    drive.start_homing()
    rig.run(0.001)
    start_ns = rig.bench.clock.now_ns()
    assert rig.bench.slave.profile.statusword() & 0x3400 == 0x1400  # attained, and nobody saw it low
    assert drive.sample().homed is False
    drive.wait_for(lambda sample: sample.homed is True, 1.0, "homed")
    assert 0.25e9 <= rig.bench.clock.now_ns() - start_ns < 0.35e9


# -- supervision -----------------------------------------------------------------------------------------------------------


def test_a_dictionary_file_of_another_vendor_is_named(make: MakeRig, tmp_path: Path) -> None:
    rig = make()
    rig.drive.node.eds = load_eds(EDS, NODE)
    rig.opened()
    assert not any("maker's file" in note for note in rig.drive.notes)
    other = make()
    path = tmp_path / "other.eds"
    text = (
        EDS.read_text(encoding="utf-8").replace("0x000004E1", "0xFB").replace("VendorNumber=0x4E1", "VendorNumber=0xFB")
    )
    path.write_text(
        f"{text}\n[40F7]\nParameterName=odd\nDataType=0x0005\nAccessType=rw\nDefaultValue=soon\n", encoding="utf-8"
    )
    other.drive.node.eds = load_eds(path, NODE)
    assert other.drive.node.eds.vendors() == {0xFB}
    other.opened()
    assert "the maker's file (eds) is for vendor id 0xfb, this drive reports 0x4e1" in other.drive.notes
    assert any(note.startswith("the maker's file (eds): ") and "40F7" in note for note in other.drive.notes)


@pytest.mark.parametrize(
    ("vendor", "unit"),
    [("0x2BE", "rpm"), ("0xFB", "rpm"), ("0x26C", "rpm"), ("0x147", "rpm"), ("0x4E1", "counts/s"), ("0", "counts/s")],
)
@pytest.mark.parametrize("silent", [True, False])
def test_a_drive_without_an_identity_has_the_units_of_its_makers_file(
    make: MakeRig, tmp_path: Path, vendor: str, unit: str, silent: bool
) -> None:
    """Oriental Motor, maxon, Nanotec and Faulhaber count r/min by their manuals, and no object says so."""
    path = tmp_path / "maker.eds"
    path.write_text(
        EDS.read_text(encoding="utf-8")
        .replace("0x000004E1", vendor)
        .replace("VendorNumber=0x4E1", f"VendorNumber={vendor}"),
        encoding="utf-8",
    )
    rig = make(lacking=(0x1018, *(range(0x60A9, 0x60AB))) if silent else range(0x60A9, 0x60AB))
    rig.drive.node.eds = load_eds(path, NODE)
    units = rig.opened().motion_scaling()
    assert units.velocity.text == (unit if silent else "counts/s")
    assert not units.ambiguous
    raw = CanOpenRawParameters(rig.drive.node, CanLine(rig.link), scaling=rig.drive.scaling)
    raw.line.run([raw.identify()])
    parameter = raw.find("6099h:01")
    assert parameter is not None
    assert raw.unit_of(parameter) == units.velocity.text  # as `hil params` shows it
    assert any("reports no vendor" in note for note in rig.drive.notes) is silent


def test_a_silent_heartbeat_is_a_lost_link(make: MakeRig) -> None:
    rig = make(CanFault(K.HEARTBEAT_STOPS, at_s=1.0), heartbeat_s=0.1)
    drive = rig.opened()
    rig.run(0.9)
    drive.sample()
    rig.run(0.4)
    drive.sample()  # it answers: its heartbeat may be late
    rig.run(0.3)
    with pytest.raises(
        LinkLostError, match=r"no heartbeat of node 5 for 0\.[5-7]\d+ s, expected every 0.25 s at least"
    ):
        drive.sample()


@pytest.mark.parametrize(("lost_s", "answers"), [(0.15, True), (0.35, True), (2.0, False)])
def test_a_sync_that_is_not_answered_is_sent_again_within_the_deadline(
    make: MakeRig, lost_s: float, answers: bool
) -> None:
    """As on a computer whose other processes keep the drive's from running."""
    rig = make(CanFault(K.TPDO_LOST, at_s=1.0, duration_s=lost_s))
    drive = rig.opened()
    rig.run(1.0)
    start_ns = rig.bench.clock.now_ns()
    if answers:
        drive.sample()
        assert rig.bench.clock.now_ns() - start_ns < (lost_s + 0.4) * 1e9
    else:
        with pytest.raises(NoAnswerError, match=r"does not answer SYNC within 0\.1 s, asked 5 times"):
            drive.sample()
        assert rig.bench.clock.now_ns() - start_ns < 0.55e9


class BusyHost:
    """The bus of a computer whose other processes keep this one waiting: a wait lasts `times` as long, and a frame is handed on
    `late_s` after it came, only to one who waits."""

    def __init__(self, rig: Rig, *, times: float = 1.0, late_s: float = 0.0) -> None:
        self._port, self._clock = rig.link.bus, rig.bench.clock
        self._times, self._late_ns = times, round(late_s * 1e9)
        self._held: deque[tuple[int, can.Message]] = deque()
        rig.link.bus = self  # type: ignore[assignment]

    def __getattr__(self, name: str) -> object:
        return getattr(self._port, name)

    def recv(self, timeout: float) -> can.Message | None:
        end_ns = self._clock.now_ns() + round(timeout * self._times * 1e9)
        while True:
            while (message := self._port.recv(0.0)) is not None:
                self._held.append((round(message.timestamp * 1e9) + self._late_ns, message))
            if timeout and self._held and self._held[0][0] <= self._clock.now_ns():
                return self._held.popleft()[1]
            if self._clock.now_ns() >= end_ns:
                return None
            self._clock.sleep_until_ns(min(end_ns, self._clock.now_ns() + 1_000_000))


@pytest.mark.parametrize(
    ("times", "late_s", "good"), [(1, 0.08, True), (8, 0.7, True), (1, 0.7, False), (8, 9.9, False)]
)
def test_an_answer_is_late_by_what_was_listened(make: MakeRig, times: int, late_s: float, good: bool) -> None:
    """A process that gets an eighth of a processor gives its peer the time that it has itself; one that runs freely does not."""
    rig = make(heartbeat_s=None)
    drive = rig.opened()
    BusyHost(rig, times=times, late_s=late_s)
    start_ns = rig.bench.clock.now_ns()
    if good:
        assert drive.sample().earliest_ns >= start_ns
        return
    with pytest.raises(NoAnswerError, match=r"does not answer SYNC within 0\.1 s, asked 5 times"):
        drive.sample()
    assert rig.bench.clock.now_ns() - start_ns < 0.55e9 * times


@pytest.mark.parametrize("stops", [None, K.HEARTBEAT_STOPS, K.NODE_DEAD])
@pytest.mark.parametrize("held_up_s", [0.6, 1.4, 5.0])
def test_a_heartbeat_is_judged_once_what_came_was_received(
    make: MakeRig, held_up_s: float, stops: CanFaultKind | None
) -> None:
    """A process that was held up finds nothing at its first look; the kernel hands on what came while it waits for the sample."""
    rig = make(*([CanFault(stops, at_s=1.0)] if stops else []), heartbeat_s=0.1)
    drive = rig.opened()
    rig.run(0.9)
    drive.sample()
    BusyHost(rig)
    rig.run(held_up_s)
    if stops is None:
        drive.sample()
        return
    with pytest.raises(LinkLostError, match="no heartbeat of node 5"):  # noqa: PT012 - one of the next samples, not a certain one
        for _ in range(8):
            drive.sample()
            rig.run(0.1)


@pytest.mark.parametrize("read_last", [(0x6502, 0), (0x608F, 1)])
def test_a_restart_while_it_is_opened_is_noticed(make: MakeRig, read_last: tuple[int, int]) -> None:
    """What was read of the drive before it, such as its units, may not hold after it."""
    rig = make()
    slave, value = rig.bench.slave, rig.bench.slave.dictionary.number(*read_last)
    restarts = iter([slave.boot])

    def read() -> int:
        for restart in restarts:
            restart(rig.bench.clock.now_ns())
        return value

    slave.dictionary.on_read(*read_last, read)
    with pytest.raises(LinkLostError, match="node 5 restarted by itself; open it again"):
        rig.opened()
    assert rig.opened().sample().state is DriveState.SWITCH_ON_DISABLED


def test_a_restart_is_noticed(make: MakeRig) -> None:
    rig = make(CanFault(K.REBOOT, at_s=1.0))
    drive = rig.opened()
    rig.run(1.2)
    with pytest.raises(LinkLostError, match="node 5 restarted by itself; open it again"):
        drive.sample()
    drive.close()
    drive.open()
    assert drive.sample().state is DriveState.SWITCH_ON_DISABLED


def test_emergencies_are_logged_with_their_meaning(make: MakeRig) -> None:
    rig = make()
    drive = rig.opened()
    rig.bench.servo.raise_fault(0x4310)
    rig.run(0.1)
    drive.sample()
    assert rig.number(0x1003, 1) & 0xFFFF == 0x4310
    drive.reset_fault()
    drive.sample()
    texts = [str(emergency) for emergency in drive.monitor.log]
    assert texts == [
        "drive over-temperature (4310h), register 09h, extra 0000000000",
        "no error (0000h), register 00h, extra 0000000000",
    ]


def test_the_log_of_a_burst_is_bounded(make: MakeRig) -> None:
    rig = make(CanFault(K.EMCY_BURST, at_s=0.5, size=1000))
    drive = rig.opened()
    rig.run(0.6)
    assert drive.sample().state is DriveState.SWITCH_ON_DISABLED
    assert len(drive.monitor.log) == 256


def test_a_master_that_dies_stops_the_axis(make: MakeRig) -> None:
    """The process is gone in the middle of a move: the drive misses our heartbeat (1016h) and quick-stops (6007h)."""
    rig = make(guard_s=0.2)
    rig.drive.open()
    rig.drive.enable()
    rig.drive.start_move(190.0, 50.0)
    rig.run(1.0)
    rig.link.close()
    rig.run(1.0)
    assert rig.bench.servo.velocity_actual_counts_s == 0
    assert rig.bench.servo.motor_rev * 10.0 < 70.0
    assert rig.bench.slave.profile.state is DriveState.SWITCH_ON_DISABLED
    rig.drive.close()


@pytest.mark.parametrize("lacking", [(0x6007,), ()])
def test_a_drive_that_keeps_its_own_reaction_stops_all_the_same_when_its_master_dies(
    make: MakeRig, lacking: tuple[int, ...]
) -> None:
    """6007h missing, or fixed: 1016h alone has the drive notice, and its fault reaction stop the axis."""
    rig = make(
        guard_s=0.2,
        lacking=lacking,
        refused=() if lacking else ((0x6007, 0),),
        parameters=None if lacking else {(0x6007, 0): 1},
    )
    rig.drive.open()
    assert [note for note in rig.drive.notes if "its own reaction holds" in note]
    rig.drive.enable()
    rig.drive.start_move(190.0, 50.0)
    rig.run(1.0)
    rig.link.close()
    rig.run(1.0)
    assert rig.bench.servo.velocity_actual_counts_s == 0
    assert rig.bench.servo.motor_rev * 10.0 < 70.0
    assert rig.bench.slave.profile.state is DriveState.FAULT
    rig.drive.close()


def test_a_drive_that_cannot_watch_its_master_is_left_alone_and_noted(make: MakeRig) -> None:
    rig = make(guard_s=0.2, lacking=(0x1016,))
    heard: list[int] = []
    node = rig.bench.wire.add_node()
    node.connect(lambda cob_id, _data, _now_ns: heard.append(cob_id), lambda _now_ns: None, lambda: None)
    drive = rig.opened()
    assert any("does not watch its master" in note and "1016h:00" in note for note in drive.notes)
    rig.run(1.0)
    assert 0x77F not in heard
    drive.enable()
    assert drive.sample().state is DriveState.ENABLED


def test_an_entry_that_watches_another_node_is_left_to_it(make: MakeRig) -> None:
    other = 20 << 16 | 500
    rig = make(guard_s=0.2, parameters={(0x1016, 1): other})
    with rig.drive as drive:
        assert drive.notes == []
        assert rig.number(0x1016, 1) == other
        assert rig.number(0x1016, 2) == 127 << 16 | 200
    assert rig.number(0x1016, 2) == 0


def test_a_drive_whose_entries_all_watch_others_is_noted(make: MakeRig) -> None:
    others = {(0x1016, 1): 20 << 16 | 500, (0x1016, 2): 21 << 16 | 500}
    rig = make(guard_s=0.2, parameters={**others, (0x6007, 0): 1})
    drive = rig.opened()
    assert any("every entry of 1016h watches another node" in note for note in drive.notes)
    assert (rig.number(0x1016, 1), rig.number(0x1016, 2), rig.number(0x6007)) == (*others.values(), 1)
