"""Documented drives: their profiles as data, what the drive needs to meet them, and the matrix profile x verb.

Each profile's facts come from a source outside this project; the shaft's true motion is asked of the simulated servo.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import can
import pytest
from study.makers_matrix import LEAD_MM, SPEED_MM_S
from study.profiles_matrix import (
    ProfileTrial,
    profiles_summary,
    run_verbs,
    scanned,
    study_profiles,
    trial_of,
)

from drivers.cia402.homing import HomingSettings
from drivers.cia402.modes import Mode
from drivers.drive import Capability, DriveState, HomingSpeeds
from drivers.errors import CapabilityError, DriveFaultError, InputError, ProtocolError
from drivers.limits import DriveLimits
from hil.app.main import main
from hil.machine.supervisor import homing_time_s
from sim_backends import profile_paths
from sim_backends.canopen_quirks import ProfiledSlave
from sim_backends.drive_profiles import BASE, STRENGTHS, load_profile
from sim_backends.faults import CanFaultKind
from sim_backends.maker_file import read_maker_file

NAMES = tuple(profile_paths())
SAMPLE = ("ipos", "leadshine_2cs3e", "old_node")
"""For the default suite: a slow loop and units of its own; states that are shown late or always; PDOs that cannot be switched off."""
TEXT = """
[drive]
maker = "somebody"
model = "drive"
wire = "CANopen"

[[fact]]
says = "a"
source = "b"
strength = "run"
values = { "6502h" = 0x25 }

[[fact]]
says = "c"
source = "d"
strength = "notes"
loop_s = 0.001
"""


def _written(tmp_path: Path, old: str = "", new: str = "", *, text: str = TEXT) -> Path:
    path = tmp_path / "some.toml"
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


def _with(tmp_path: Path, switches: str) -> ProfileTrial:
    """A trial of the standard's drive with some switches; it homes to its negative limit switch."""
    text = TEXT[: TEXT.index("[[fact]]")] + "[axis_file]\nhoming_method = 17\n"
    fact = f'[[fact]]\nsays = "a"\nsource = "b"\nstrength = "run"\n{switches}\n'
    return ProfileTrial(load_profile(_written(tmp_path, text=text + fact)))


def _enabled(trial: ProfileTrial) -> Any:
    drive = trial.drive
    drive.open()
    drive.enable()
    return drive


# -- profiles as data --------------------------------------------------------------------------------------------------------
def test_every_profile_names_the_source_of_each_fact() -> None:
    profiles = [load_profile(name) for name in NAMES]
    assert sum(profile.maker != "not named" for profile in profiles) >= 20
    for profile in profiles:
        assert profile.facts
        for fact in profile.facts:
            assert len(fact.source) > 8
            assert fact.strength in STRENGTHS
            assert "verified" not in fact.says
        text = profile_paths()[profile.name].read_text(encoding="utf-8")
        assert "not verified on hardware" in text.splitlines()[0]


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("loop_s = 0.001", "lop_s = 0.001", 17, "unknown key lop_s, the nearest known one is loop_s"),
        ("loop_s = 0.001", "loop_s = 2.0", 17, "loop_s is 2.0, expected seconds, 0 to 0.1"),
        ("loop_s = 0.001", 'values = { "6502h" = 1 }', 17, "names 6502h, which another fact names already"),
        ('"6502h"', '"6502"', 11, 'expected an object such as "6098h" or "6099h:01"'),
        ('source = "d"\n', "", 13, "lacks source"),
        ('"notes"', '"verified"', 16, "strength is verified, expected maker, run, notes or assumed"),
        ("loop_s = 0.001", "statusword_bits = { sometimes = 1 }", 17, "expected always, enabled or fault"),
        ("loop_s = 0.001", "homing_methods = [300]", 17, "homing_methods"),
        ('values = { "6502h" = 0x25 }', "loop_s = 0.002", 17, "is set by fact 1 already"),
        ('wire = "CANopen"', "", 2, "lacks wire"),
    ],
)
def test_unknown_keys_and_bad_values_are_refused_with_their_line(
    tmp_path: Path, old: str, new: str, line: int, words: str
) -> None:
    path = _written(tmp_path, old, new)
    with pytest.raises(InputError) as refused:
        load_profile(path)
    assert words in str(refused.value)
    assert str(refused.value).startswith(f"{path}:{line}:")


def test_a_value_of_an_object_that_the_drive_has_not_is_refused(tmp_path: Path) -> None:
    profile = load_profile(_written(tmp_path, '"6502h"', '"60A9h"'))
    with pytest.raises(InputError, match="60A9h has a defaultvalue and is no object"):
        profile.over()


def test_an_unknown_profile_is_answered_with_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"profile 'epos5', expected a file or one of .*epos4"):
        load_profile("epos5")


def test_facts_change_the_objects() -> None:
    """Literal values of the sources."""
    epos = load_profile("epos4").over()
    assert epos.number(0x6502) == 0x225
    assert epos.number(0x6098) == 37
    assert (0x608F, 1) not in epos.texts
    assert load_profile("tmcm_1617").over().texts[0x6084, 0]["accesstype"] == "ro"
    wecon = load_profile("vd3e")
    assert {index for index, _ in wecon.over().texts if 0x1400 <= index < 0x1600} == {0x1400}
    assert 1 / wecon.units(wecon.over(), 0.01).position_rev == 2**23
    kinco = load_profile("kinco_fd5")
    assert 1000 * 512 * 65536 / 1875 * kinco.units(kinco.over(), 0.01).velocity_rev_s == pytest.approx(1000 / 60)
    assert 100 * 65536 * 65536 / 4e6 * kinco.units(kinco.over(), 0.01).acceleration_rev_s2 == pytest.approx(100)
    ipos = load_profile("ipos")
    assert ipos.units(ipos.over(), 0.01).velocity_rev_s == pytest.approx(1000 / 65536 / 8192)


def test_behaviour_of_a_profile_over_the_objects_of_a_makers_file() -> None:
    profile = load_profile("jvl_mis")
    objects = profile.over(read_maker_file(BASE))
    assert (0x2201, 0) in objects.texts  # a maker's own object of the file; the profile alone has none
    assert (0x2201, 0) not in profile.over().texts
    assert objects.product != profile.model


# -- what the drive needs to meet them ---------------------------------------------------------------------------------------
def test_of_two_commands_within_a_slow_loop_the_edge_is_not_lost() -> None:
    """iPOS: 1 ms loop. After a homing bit 4 is set; the next set-point is its rising edge."""
    trial = trial_of("ipos")
    drive = _enabled(trial)
    drive.home(60.0)
    start = drive.sample().position_load_mm
    drive.start_move(start + 5.0, SPEED_MM_S)
    assert drive.wait_for(lambda sample: sample.target_reached, 10.0, "there").position_load_mm == pytest.approx(
        start + 5.0, abs=0.01
    )
    drive.start_homing()
    drive.wait_for(lambda sample: sample.homed is True, 60.0, "homed")
    drive.disable()
    drive.close()


@pytest.mark.parametrize("reopened", [False, True])
def test_a_fault_bit_that_stays_until_a_shutdown_is_cleared(reopened: bool) -> None:
    trial = trial_of("ipos")
    drive = _enabled(trial)
    trial.servo.raise_fault(0x8611)
    trial.clock.sleep_s(0.1)
    assert drive.sample().state is DriveState.FAULT
    if reopened:  # another master has reset it
        trial.servo.reset_fault()
        trial.slave.profile.state = DriveState.SWITCH_ON_DISABLED
        trial.slave.profile._fault_bit = True  # type: ignore[attr-defined]
        assert drive.sample().state is DriveState.UNKNOWN
    else:
        drive.reset_fault()
        assert drive.sample().state is DriveState.SWITCH_ON_DISABLED
    drive.enable()
    assert drive.sample().state is DriveState.ENABLED
    drive.disable()
    drive.close()


def test_bit_10_that_never_falls_is_no_arrival() -> None:
    trial = trial_of("leadshine_2cs3e")
    drive = _enabled(trial)
    start = trial.shaft_mm()
    drive.start_move(drive.sample().position_load_mm + 5.0, SPEED_MM_S)
    assert not drive.sample().target_reached
    drive.wait_for(lambda sample: sample.target_reached, 10.0, "there")
    assert trial.shaft_mm() - start == pytest.approx(5.0, abs=0.01)
    drive.disable()
    drive.close()


def test_bit_12_that_stays_until_the_arrival_does_not_keep_the_order() -> None:
    """BLV-R: whoever started the move watches it from the begin on."""
    trial = trial_of("oriental_blvd")
    drive = _enabled(trial)
    began_ns = trial.clock.now_ns()
    drive.start_move(20.0, SPEED_MM_S)
    assert trial.clock.now_ns() - began_ns < 200_000_000
    assert trial.slave.dictionary.number(0x6041) & 0x1000
    drive.wait_for(lambda sample: sample.target_reached, 10.0, "there")
    drive.start_move(10.0, SPEED_MM_S)
    drive.wait_for(lambda sample: sample.target_reached, 10.0, "there")
    assert trial.shaft_mm() == pytest.approx(10.0, abs=0.01)
    drive.disable()
    drive.close()


def test_a_mode_that_is_shown_once_enabled_is_waited_for() -> None:
    trial = trial_of("leadshine_2cs3e")
    drive = trial.drive
    drive.open()
    assert trial.slave.dictionary.number(0x6061) == 0
    with pytest.raises(ProtocolError, match="6061h:00 modes of operation display stays 0"):
        drive.set_mode(Mode.HOMING)
    drive.enable()
    assert trial.slave.dictionary.number(0x6061) == Mode.PROFILE_POSITION
    drive.disable()
    drive.close()


def test_a_mode_that_is_never_shown_ends_without_power() -> None:
    trial = trial_of("leadshine_2cs3e")
    trial.slave.profile.defects.add(CanFaultKind.MODE_STUCK)
    drive = trial.drive
    drive.open()
    with pytest.raises(ProtocolError, match="mode 1 was written"):
        drive.enable()
    assert not trial.servo.powered
    drive.close()


def test_a_homing_without_bit_10_is_over_at_rest() -> None:
    trial = trial_of("jvl_mis")
    drive = _enabled(trial)
    drive.start_homing()
    sample = drive.wait_for(lambda sample: bool(sample.homed) and sample.target_reached, 60.0, "homed")
    assert sample.homed is True
    assert trial.servo.motor_rev * LEAD_MM < -20.0  # at the limit switch
    drive.disable()
    drive.close()


def test_a_homing_to_a_switch_that_does_not_move_has_failed() -> None:
    trial = trial_of("asda_a2e")
    drive = _enabled(trial)
    with pytest.raises(DriveFaultError, match="method 1 searches a switch or the index, and it is shown as attained"):
        drive.home(60.0)
    assert drive.sample().homed is False
    assert trial.shaft_mm() == 0.0
    drive.disable()
    drive.close()


def test_a_method_that_is_answered_and_not_taken_is_refused_before_motion(tmp_path: Path) -> None:
    trial = _with(tmp_path, 'homing_ignored = [17]\nhoming_methods = [37]\nvalues = { "6098h" = 37 }')
    drive = _enabled(trial)
    with pytest.raises(CapabilityError, match="method 17: it was written to 6098h, which stays 37"):
        drive.start_homing()
    assert trial.shaft_mm() == 0.0
    drive.disable()
    drive.close()


def test_pdos_whose_setting_is_not_answered_are_done_without() -> None:
    trial = trial_of("lxm28a")
    drive = _enabled(trial)
    assert any("a write to 1800h:01" in note and "sampled by SDO" in note for note in drive.notes)
    assert Capability.STREAMING not in drive.capabilities
    drive.disable()
    drive.close()
    assert scanned(trial.profile) == "yes"


def test_pdos_without_bit_31_are_mapped_by_a_count_of_0() -> None:
    trial = trial_of("old_node")
    row = trial.run()
    assert row.works, row
    assert row.cells["streams"] == "yes"


def test_the_time_of_a_homing_follows_from_distance_and_6099h() -> None:
    limits = DriveLimits(0.0, 500.0, 100.0, 1000.0)
    assert homing_time_s(limits) == pytest.approx(530.0)  # 1 mm/s
    assert homing_time_s(limits, HomingSpeeds(5.0, 5.0, 10.0)) == pytest.approx(534.0)
    slow = homing_time_s(limits, HomingSpeeds(0.25, 0.05, 10.0))
    assert slow > 500.0 / 0.25 + 10.0 / 0.05
    trial = trial_of("kinco_fd5")
    drive = trial.drive
    drive.settings = type(drive.settings)(velocity_unit="1875/30720 counts/s", homing=HomingSettings(17))
    with drive:
        speeds = drive.homing_speeds()
    assert speeds.switch_mm_s == pytest.approx(102_400 * 1875 / 512 / 65536 / 60 * LEAD_MM, rel=1e-6)
    assert speeds.turn_mm == pytest.approx(LEAD_MM)


def test_emergencies_between_question_and_answer_do_not_matter(tmp_path: Path) -> None:
    trial = _with(tmp_path, "sdo_emergency = 1")
    row = trial.run()
    assert row.works, row
    assert len(trial.drive.monitor.log) > 100


# -- where profiles are named --------------------------------------------------------------------------------------------------
def test_hil_sim_drive_runs_a_profile_and_lists_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["sim", "drive", "--help"])
    shown = capsys.readouterr().out
    assert all(name in shown for name in NAMES)
    axis = tmp_path / "X.toml"
    words = ["sim", "drive", "--interface", "slcan-pty", "--laser", "--axis-file", str(axis)]
    assert main([*words, "--profile", "kinco_fd5", "--for", "0.05"]) == 0
    first = json.loads(capsys.readouterr().out.splitlines()[0])
    assert first["drive"]["velocity_unit"] == "1875/30720 counts/s"
    text = axis.read_text(encoding="utf-8")
    assert "encoder_counts_per_motor_rev = 65536" in text
    assert re.search(r'homing = \{ *"?method"? = 17 *\}', text)
    assert main(["sim", "drive", "--interface", "slcan-pty", "--profile", "kinco"]) == 2
    assert "profile 'kinco', expected a file or one of" in capsys.readouterr().err


def test_a_profile_and_a_makers_file_together(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["sim", "drive", "--interface", "slcan-pty", "--eds", str(BASE), "--for", "0.05"]
    assert main([*words, "--profile", "jvl_mis"]) == 0
    assert "units of this drive" in capsys.readouterr().err


def test_a_bench_with_a_profile_is_refused_on_another_face(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    row = run_verbs("uniswarm", tmp_path, ("backup",))
    assert row.cells["backup"] == "yes", row
    axis = tmp_path / "X.toml"
    text = axis.read_text(encoding="utf-8")
    axis.write_text(text.replace('profile = "uniswarm"', 'profile = "uniswarm"\nface = "virtual"'), encoding="utf-8")
    assert main(["doctor", str(axis)]) == 2
    assert "[drive] profile is for face canopen, the face is virtual" in capsys.readouterr().err


# -- the matrix ------------------------------------------------------------------------------------------------------------------
@pytest.mark.outside
@pytest.mark.parametrize("name", SAMPLE)
def test_a_sample_of_the_matrix(name: str) -> None:
    rows = study_profiles([name], ("doctor", "backup", "download --dry-run", "download", "calibrate", "backlash"))
    text, good = profiles_summary(rows)
    assert good, (text, rows[0].reasons)
    assert rows[0].drive.cells["recovers"] == "yes"


@pytest.mark.outside
@pytest.mark.parametrize("name", NAMES[::3])
def test_every_verb_over_a_third_of_the_profiles(name: str) -> None:
    """All of them: `python tests/study/makers_matrix.py --profiles`, six minutes."""
    rows = study_profiles([name])
    text, good = profiles_summary(rows)
    assert good, (text, rows[0].reasons)


def test_the_profiled_slave_is_on_a_python_can_bus_as_any_other() -> None:
    """The class that `hil sim drive` and the bench use answers an SDO request put on the wire by hand."""
    trial = trial_of("epos4")
    assert isinstance(trial.slave, ProfiledSlave)
    port = trial.wire.port()
    port.send(can.Message(arbitration_id=0x605, data=b"\x40\x02\x65\x00\0\0\0\0", is_extended_id=False))
    answer = port.recv(0.1)
    while answer is not None and answer.arbitration_id != 0x585:
        answer = port.recv(0.1)
    assert answer is not None
    assert bytes(answer.data) == bytes.fromhex("4302650025020000")  # as in the candump of the source
    port.shutdown()


@pytest.mark.parametrize("mapped", ["", "as long"])
def test_a_mapping_that_is_answered_and_not_taken_is_noticed(tmp_path: Path, mapped: str) -> None:
    """The drive's own TPDO 1 is shorter than what was mapped, or as long with other contents."""
    values = (
        '\nvalues = { "1A00h:00" = 3, "1A00h:01" = 0x60410010, "1A00h:02" = 0x60FF0020, "1A00h:03" = 0x60770010,'
        ' "1A01h:01" = 0x606C0020, "1A01h:02" = 0x60F40020 }'
        if mapped
        else ""
    )
    trial = _with(tmp_path, f'pdo_mapping = "kept"{values}')
    trial.slave.dictionary.set_number(0x60FF, 0, 123_456)
    drive = _enabled(trial)
    assert any("answers a mapping of its PDOs and keeps its own" in note for note in drive.notes)
    assert drive.sample().position_load_mm == pytest.approx(trial.shaft_mm(), abs=1e-3)
    assert Capability.STREAMING not in drive.capabilities
    drive.disable()
    drive.close()
