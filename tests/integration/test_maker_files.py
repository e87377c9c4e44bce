"""Drives as their makers ship them: a strict slave made from a file, and what the bridge uses instead of what the file lacks.

The slave reads the file by itself and turns its shaft by its own understanding of the units; `study.makers_matrix` asks the shaft.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Literal

import pytest
from study.makers_matrix import SPEED_MM_S, Row, Trial, shared_data, study, summary
from support.can_bench import attach_to_wire
from support.can_wire import SimWire

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.settings import CanOpenSettings
from drivers.drive import Capability, DriveState
from drivers.errors import CapabilityError, LimitError, LinkLostError
from drivers.instruments.serial_link import SerialLink
from drivers.instruments.umd_laser import UmdLaser
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from hil.axis.axis_file import MeasurementConfig
from hil.doctor.procedure import doctor
from hil.machine.session import AxisSession
from sim_backends.bench import Bench, BenchParameters
from sim_backends.canopen_strict import StrictSlave
from sim_backends.maker_file import TRINAMIC, motion_units, read_maker_file
from sim_backends.plant.parameters import geometric_axis

HOW = MeasurementConfig(
    targets_mm=(10.0, 20.0), velocity_mm_s=50.0, dwell_s=0.2, reading_s=0.2, reference_mm=10.0, home=True
)
Change = Mapping[str, str | None]
Changes = Mapping[str, Change | None]
"""Section -> what differs from `USUAL`: entries to set (None takes one out); None takes the section out."""
I8, I16, I32, U8, U16, U32 = "0x2", "0x3", "0x4", "0x5", "0x6", "0x7"


def _o(data_type: str, access: str, default: str = "", *, mapped: bool = False, high: str = "") -> dict[str, str]:
    return {
        "ParameterName": "object",
        "ObjectType": "0x7",
        "DataType": data_type,
        "AccessType": access,
        "DefaultValue": default,
        "PDOMapping": str(int(mapped)),
        "HighLimit": high,
    }


def _pdos() -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = {}
    for base, identifier, mapped in ((0x1400, 0x200, "0x60400010"), (0x1800, 0x180, "0x60410010")):
        for number in range(2):
            communication, mapping = f"{base + number:X}", f"{base + 0x200 + number:X}"
            found[f"{communication}sub0"] = _o(U8, "ro", "2")
            found[f"{communication}sub1"] = _o(U32, "rw", f"$NODEID+0x{identifier + 0x100 * number:X}")
            found[f"{communication}sub2"] = _o(U8, "rw", "255")
            found[f"{mapping}sub0"] = _o(U8, "rw", "1", high="8")
            for subindex in range(1, 9):
                found[f"{mapping}sub{subindex}"] = _o(U32, "rw", mapped if subindex == 1 else "0")
    return found


USUAL = {
    "1000": _o(U32, "const", "0x00020192"),
    "1001": _o(U8, "ro"),
    "1005": _o(U32, "rw", "0x80"),
    "1016sub0": _o(U8, "const", "1"),
    "1016sub1": _o(U32, "rw", "0"),
    "1017": _o(U16, "rw", "0"),
    "1018sub0": _o(U8, "ro", "2"),
    "1018sub1": _o(U32, "ro", "0x1234"),
    **_pdos(),
    "6007": _o(I16, "rw", "1"),
    "6040": _o(U16, "rww", "0", mapped=True),
    "6041": _o(U16, "ro", mapped=True),
    "605A": _o(I16, "rw", "2"),
    "6060": _o(I8, "rw", "0"),
    "6061": _o(I8, "ro", mapped=True),
    "6064": _o(I32, "ro", mapped=True),
    "606C": _o(I32, "ro", mapped=True),
    "6077": _o(I16, "ro", mapped=True),
    "607A": _o(I32, "rww", "0", mapped=True),
    "6081": _o(U32, "rw", "0"),
    "6083": _o(U32, "rw", "0"),
    "6084": _o(U32, "rw", "0"),
    "6085": _o(U32, "rw", "0"),
    "6098": _o(I8, "rw", "0"),
    "6099sub0": _o(U8, "ro", "2"),
    "6099sub1": _o(U32, "rw", "0"),
    "6099sub2": _o(U32, "rw", "0"),
    "60C2sub0": _o(U8, "ro", "2"),
    "60C2sub1": _o(U8, "rw", "1"),
    "60C2sub2": _o(I8, "rw", "-3"),
    "60F4": _o(I32, "ro", mapped=True),
    "60FF": _o(I32, "rw", "0"),
    "6502": _o(U32, "ro", "0xA5"),
}
RPM = {"60A9": _o(U32, "rw", "0x00B44700")}
GUARDED = {"100C": _o(U16, "rw", "0"), "100D": _o(U8, "rw", "0")}
INTERPOLATED = {"60C1sub0": _o(U8, "ro", "1"), "60C1sub1": _o(I32, "rww", "0", mapped=True)}


@pytest.fixture
def make(tmp_path: Path) -> type[Trial]:
    """A trial of a drive by its differences from the usual one."""

    class Made(Trial):
        def __init__(self, changes: Changes | None = None, *, axis: int = 1, product: str = "made") -> None:
            sections: dict[str, dict[str, str]] = {name: dict(entry) for name, entry in USUAL.items()}
            for name, change in (changes or {}).items():
                if change is None:
                    del sections[name]
                    continue
                entry = sections.setdefault(name, {})
                entry.update({key: value for key, value in change.items() if value is not None})
            lines = [f"[DeviceInfo]\nProductName={product}\n"]
            for name, entry in sections.items():
                lines.append(f"[{name}]\n" + "".join(f"{key}={value}\n" for key, value in entry.items()))
            path = tmp_path / "made.eds"
            path.write_text("\n".join(lines), encoding="latin-1")
            super().__init__(read_maker_file(path), axis)

    return Made


def _told(row: Row) -> str:
    return "\n".join(row.reasons)


def test_the_usual_drive_needs_nothing_else(make: type[Trial]) -> None:
    row = make().run()
    assert row.works, row
    assert row.reasons == []
    assert set(row.cells.values()) >= {"yes"}


WITHOUT_TPDOS: Changes = {f"1A0{number}sub0": {"AccessType": "ro"} for number in range(2)}
CASES: list[tuple[str, Changes, str]] = [
    ("rpm", RPM, ""),
    ("milli-rpm", {"60A9": _o(U32, "rw", "0xFDB44700")}, ""),
    ("degrees", {"60A8": _o(U32, "rw", "0xFF410000"), "60A9": _o(U32, "rw", "0x00B44700")}, ""),
    ("notation", {"608B": _o(I8, "rw", "0xFF"), "608C": _o(U8, "rw", "0xA4")}, ""),
    ("factor", {"6094sub1": _o(U32, "rw", "4096"), "6094sub2": _o(U32, "rw", "60")}, ""),
    ("no 6007h", {"6007": None}, "it has no 6007h"),
    ("no 6084h", {"6084": None}, "6083h serves both ramps"),
    ("6084h read-only", {"6084": {"AccessType": "ro"}}, "6083h serves both ramps"),
    ("no 6502h", {"6502": None}, "by trial at standstill: profile position, profile velocity, homing"),
    ("6060h write-only", {"6060": {"AccessType": "wo"}}, ""),
    ("RPDO type fixed", {"1400sub2": {"AccessType": "ro"}}, ""),
    (
        "RPDOs fixed",
        {f"140{n}sub1": {"AccessType": "ro", "DefaultValue": "0x321"} for n in range(2)},
        "set-points are not streamed",
    ),
    ("COB-IDs read-only", {f"1{b}0{n}sub1": {"AccessType": "ro"} for b in "48" for n in range(2)}, ""),
    ("TPDO mapping read-only", WITHOUT_TPDOS, "is sampled by SDO, as it takes no TPDO"),
    ("no SYNC", {"1005": None}, "has no SYNC (1005h)"),
    ("no heartbeat", {"1017": None}, "produces no heartbeat (drive made: 1017h:00 refused"),
    (
        "guarding alone",
        {"1017": None, "1016sub0": None, "1016sub1": None, **GUARDED},
        "it is watched by node guarding, and by it",
    ),
    ("heartbeat not consumed", {"1016sub0": None, "1016sub1": None, **GUARDED}, "consumes no heartbeat (1016h)"),
    ("6077h 32 bits", {"6077": {"DataType": I32}}, "does not map 6077h:00"),
    ("6077h not mappable", {"6077": {"PDOMapping": "0"}}, "does not map 6077h:00"),
    ("no 606Ch", {"606C": None, "60FF": None, "6502": {"DefaultValue": "0xA1"}}, ""),
    ("target torque of 32 bits", {"6071": _o(I32, "rw", "0"), "6502": {"DefaultValue": "0x2A5"}}, ""),
    ("profile 0", {"1000": {"DefaultValue": "0"}}, ""),
    ("no device type", {"1000": None}, ""),
    ("homing chosen by the drive", {"6098": {"AccessType": "const"}}, ""),
    ("interpolated", {**INTERPOLATED, "6502": {"DefaultValue": "0x65"}}, "streams use interpolated position"),
    (
        "no profile position",
        {**INTERPOLATED, "6502": {"DefaultValue": "0x64"}},
        "it is moved by set-points (interpolated position)",
    ),
    ("cyclic position alone", {"6502": {"DefaultValue": "0xA4"}}, "it is moved by set-points (cyclic position)"),
    (
        "ramp limited",
        {"6083": {"HighLimit": "20000"}, "6084": {"HighLimit": "20000"}},
        "(6083h:00 profile acceleration) instead of the axis file's 100",
    ),
    ("60C5h", {"60C5": _o(U32, "rw", "20000")}, "allows 48.83 mm/s² (6083h:00 profile acceleration)"),
]


@pytest.mark.parametrize(("changes", "words"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_what_a_drive_lacks_is_replaced_and_said(make: type[Trial], changes: Changes, words: str) -> None:
    row = make(changes).run()
    assert row.works, row
    assert row.worst <= 1.05
    assert words in _told(row)
    assert sum(words in line for line in row.reasons) <= 1 or not words  # once


def test_position_by_set_points_obeys_halt_and_stop(make: type[Trial]) -> None:
    trial = make({**INTERPOLATED, "6502": {"DefaultValue": "0x64"}})
    drive, clock = trial.drive, trial.clock
    with drive:
        drive.enable()
        assert Capability.PROFILE_POSITION in drive.capabilities
        drive.start_move(20.0, SPEED_MM_S)
        for _ in range(100):
            drive.sample()
            clock.sleep_s(0.01)
        drive.motion.halt()
        clock.sleep_s(0.2)
        place = trial.shaft_mm()
        for _ in range(50):
            drive.sample()
            clock.sleep_s(0.01)
        assert 1.0 < trial.shaft_mm() == pytest.approx(place, abs=1e-3)
        drive.start_move(20.0, SPEED_MM_S)
        drive.wait_for(lambda sample: sample.target_reached, 10.0, "there")
        assert trial.shaft_mm() == pytest.approx(20.0, abs=0.01)
        drive.start_move(0.0, SPEED_MM_S)
        for _ in range(50):
            drive.sample()
            clock.sleep_s(0.01)
        drive.quick_stop()
        clock.sleep_s(0.5)
        place = trial.shaft_mm()
        clock.sleep_s(0.5)
        assert trial.shaft_mm() == pytest.approx(place, abs=1e-6)
        drive.disable()


def test_whoever_stops_sampling_stops_a_move_by_set_points(make: type[Trial]) -> None:
    trial = make({**INTERPOLATED, "6502": {"DefaultValue": "0x64"}})
    with trial.drive as drive:
        drive.enable()
        drive.start_move(20.0, SPEED_MM_S)
        for _ in range(100):
            drive.sample()
            trial.clock.sleep_s(0.01)
        place = trial.shaft_mm()
        trial.clock.sleep_s(5.0)
        assert trial.shaft_mm() == pytest.approx(place, abs=0.5)
        drive.disable()


def test_ambiguous_units_are_refused_before_power(make: type[Trial]) -> None:
    trial = make({"1018sub1": {"DefaultValue": hex(TRINAMIC)}})
    drive = trial.drive
    drive.settings = replace(drive.settings, velocity_unit=None)
    with drive:
        with pytest.raises(
            CapabilityError, match=r"unit of velocity is not known: .* state velocity_unit in \[drive\]"
        ):
            drive.enable()
        assert drive.sample().state is DriveState.SWITCH_ON_DISABLED
    assert not trial.servo.powered
    assert trial.shaft_mm() == 0.0


def test_a_velocity_above_the_drives_own_limit_is_refused_before_motion(make: type[Trial]) -> None:
    """607Fh of 30 rpm: the drive would go on with 5 mm/s in silence."""
    trial = make({**RPM, "607F": _o(U32, "rw", "30")})
    with trial.drive as drive:
        drive.enable()
        with pytest.raises(LimitError, match=r"10 mm/s is more than its drive allows, 5 mm/s \(607Fh\)"):
            drive.start_move(20.0, SPEED_MM_S)
        assert drive.sample().state is DriveState.ENABLED
        assert trial.shaft_mm() == 0.0
        drive.start_move(20.0, 5.0)
        drive.wait_for(lambda sample: sample.target_reached, 10.0, "there")
        drive.disable()


def test_a_drive_that_waits_for_its_first_controlword(make: type[Trial]) -> None:
    trial = make()
    profile = trial.slave.profile
    profile.state = DriveState.NOT_READY

    def wake(_word: int) -> None:
        if profile.state is DriveState.NOT_READY:
            profile.state = DriveState.SWITCH_ON_DISABLED

    trial.slave.dictionary.on_write(0x6040, 0, wake)
    with trial.drive as drive:
        drive.enable()
        assert drive.sample().state is DriveState.ENABLED
        drive.disable()


@pytest.mark.parametrize("without", [("1016sub0", "1016sub1"), ("1016sub0", "1016sub1", "1017")])
def test_a_guarded_drive_stops_when_its_master_dies_and_the_master_hears_when_it_dies(
    make: type[Trial], without: tuple[str, ...]
) -> None:
    trial = make({**dict.fromkeys(without), **GUARDED})
    drive, clock = trial.drive, trial.clock
    drive.open()
    drive.enable()
    drive.start_move(200.0, SPEED_MM_S)
    for _ in range(200):
        drive.sample()
        clock.sleep_s(0.01)
    assert trial.watch.now_rev_s == pytest.approx(1.0, rel=0.01)
    silenced = trial.slave.on_remote
    trial.slave.on_remote = lambda _cob_id, _now_ns: None  # type: ignore[method-assign]
    for node in trial.wire._nodes:
        if node.on_remote == silenced:
            node.on_remote = lambda _cob_id, _now_ns: None

    def sampled_for_3_s() -> None:
        for _ in range(300):
            drive.sample()
            clock.sleep_s(0.01)

    with pytest.raises(LinkLostError, match="no heartbeat of node 5"):
        sampled_for_3_s()  # a node that still answers has twice its time
    clock.sleep_s(2.0)
    assert trial.watch.now_rev_s == 0.0
    assert trial.shaft_mm() < 60.0


def test_the_second_axis_of_a_node(make: type[Trial]) -> None:
    second = {
        f"{int(name[:4], 16) + 0x800:X}{name[4:]}": entry for name, entry in USUAL.items() if name.startswith("6")
    }
    trial = make({**second, "6881": {**second["6881"], "HighLimit": "40000"}}, axis=2)
    row = trial.run()
    assert row.works, row
    assert trial.slave.profile.state is DriveState.SWITCH_ON_DISABLED
    other = trial.slave._servos[0]
    assert other is not trial.servo
    assert other.motor_rev == 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"1000": {"DefaultValue": "0x00020191"}}, "device profile 401, not 402"),
        ({"6041": None}, "is no drive of profile 402"),
        ({"6064": None}, "6064h:00 refused: object does not exist"),
        ({"607A": None, "60FF": None, "6502": {"DefaultValue": "0x20"}}, "no mode that moves an axis"),
    ],
)
def test_what_cannot_be_moved_is_refused_before_motion(make: type[Trial], changes: Changes, words: str) -> None:
    row = make(changes).run()
    assert row.refused_safely, row
    assert words in _told(row)


def test_the_strict_slave_understands_units_by_itself(make: type[Trial]) -> None:
    """Literal figures: what the slave's shaft does is not taken from the bridge's converter."""
    maker = make(RPM).maker
    assert motion_units(maker, 4096, 0.010).velocity_rev_s == pytest.approx(1 / 60)
    assert motion_units(make().maker, 4096, 0.010).velocity_rev_s == pytest.approx(1 / 4096)
    degrees = motion_units(make({"60A8": _o(U32, "rw", "0xFF410000")}).maker, 4096, 0.010)
    assert (degrees.position_rev, degrees.velocity_rev_s) == (pytest.approx(1 / 3600), pytest.approx(1 / 3600))
    trial = make(RPM)
    trial.slave.profile._servo.servo.power_on()
    trial.slave.profile._servo.move_velocity(60, 0)
    trial.clock.sleep_s(2.0)
    assert trial.watch.now_rev_s == pytest.approx(1.0, rel=1e-3)


@pytest.mark.outside
def test_every_dictionary_of_the_shared_files() -> None:
    folder = shared_data()
    if folder is None:
        pytest.skip("no makers' files: set HIL_SHARED_DATA")
    text, good = summary(study(folder, []))
    assert good, text


@pytest.mark.parametrize(
    ("changes", "stated", "scaling", "words"),
    [
        ({"1018sub1": None}, None, (4096, 1), "speed"),  # r/min taken for counts/s: the file alone knows the maker
        ({}, "rpm", (4096, 1), "speed"),  # counts/s taken for r/min
        ({}, "0.1 rpm", (4096, 1), "speed"),
        ({}, None, (1024, 1), "units"),  # lines taken for counts
        ({}, None, (4096, -1), "units"),
    ],
)
def test_the_doctor_finds_wrong_units_before_a_millimetre_is_moved(
    make: type[Trial],
    changes: Changes,
    stated: str | None,
    scaling: tuple[int, Literal[1, -1]],
    words: str,
) -> None:
    """The slave takes 4096 counts per turn and its file's velocity; the axis file is wrong."""
    maker = make(changes).maker
    if stated is None and "1018sub1" in changes:
        maker = replace(maker, device={"vendornumber": "0x147"})
    parameters = BenchParameters(plant=geometric_axis(3))
    with Bench(parameters) as bench:
        start_mm, reach = bench.plant.position_mm, [0.0]

        def look(_now_ns: int, _dt_s: float) -> None:
            reach[0] = max(reach[0], abs(bench.plant.position_mm - start_mm))

        bench.clock.attach(look, bearable=bench.servo.bearable)
        wire = SimWire(bench.clock)
        attach_to_wire(wire, bench.servo, 1, make=partial(StrictSlave, maker=maker))
        with CanLink(wire.port(), bench.clock) as link:
            drive = CanOpenDrive(
                "X",
                AxisScaling(scaling[0], 10.0, direction=scaling[1]),
                DriveLimits(-100.0, 500.0, 100.0, 500.0),
                bench.clock,
                link=link,
                node_id=1,
                settings=CanOpenSettings(velocity_unit=stated),
            )
            laser = UmdLaser(SerialLink(bench.laser_path), bench.clock)
            with AxisSession(drive, laser, HOW) as session:
                checks = {check.name: check for check in doctor(session)}
    assert [name for name, check in checks.items() if not check.good] == [words], checks
    assert reach[0] < 1.0
