"""`hil drives` as a user types it, and the way from a scan over a first axis file to a proven axis."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import pytest
from study.modbus_families import FEED_MM, HOW, Rig, Scale, failures
from support.maker_drives import FAMILIES, DeltaAsdaA2, LeadshineEl7, LichuanA5, MrJeC, served
from support.served_drive import served as served_can

from drivers.clock import WallClock
from drivers.drive_notes import shipped_notes
from drivers.errors import StateError
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_facts import FactLedger
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_map import find_map, shipped_maps
from drivers.scaling import AxisScaling, motion_unit
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.doctor.procedure import doctor
from hil.machine.axis_lock import modbus_endpoint
from hil.machine.session import AxisSession
from hil.machine.wiring import connected_drive
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import tcp_server
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import SimulatedServo

KNOWN = ("--travel=-300,300", "--max-velocity", "200", "--max-acceleration", "2000", "--feed", str(FEED_MM))


def new(tmp_path: Path, name: str, port: int, *more: str) -> tuple[int, Path]:
    path = tmp_path / "X.toml"
    arguments = [str(path), "--drive", name, "--tcp", f"127.0.0.1:{port}", "--timeout", "10", *KNOWN]
    return main(["drives", "new", *arguments, "--instrument-port", "/dev/ttyUSB0", *more]), path


def test_every_drive_file_is_listed_with_what_is_not_proven(tmp_path: Path) -> None:
    out = tmp_path / "list.json"
    assert main(["drives", "list", "--json", str(out)]) == 0
    listed = json.loads(out.read_text())
    drives = {each["name"]: each for each in listed["drives"]}
    assert set(drives) == set(shipped_maps())
    assert len(set(drives) & set(FAMILIES)) >= 8
    assert not any(each["verified_on_hardware"] for each in drives.values())
    assert all(drives[name]["to_be_proven"] for name in FAMILIES)
    notes = listed["notes"]
    assert set(notes) == set(shipped_notes())
    assert not set(notes) & set(drives)
    assert sum(each["wire"] == "CANopen" for each in notes.values()) >= 14
    assert not any(each["verified_on_hardware"] for each in notes.values())


@pytest.mark.parametrize("name", shipped_notes())
def test_each_note_states_source_and_strength_and_is_shown(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "show.json"
    assert main(["drives", "show", name, "--json", str(out)]) == 0
    form, said = json.loads(out.read_text()), capsys.readouterr().out
    assert "verified on hardware  no" in said
    assert form["facts"]
    assert all(each["source"] and each["strength"] for each in form["facts"])
    assert not any("[k]" in each["says"] for each in form["facts"])


@pytest.mark.parametrize("name", [name for name, notes in shipped_notes().items() if notes.head.no_file])
def test_a_drive_without_a_file_is_refused_with_the_reason(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["drives", "new", str(tmp_path / "X.toml"), "--drive", name, "--channel", "none", "--node", "1"]) == 2
    said = capfd.readouterr().err
    assert "there is no drive file for" in said
    assert shipped_notes()[name].head.no_file in said


def test_units_that_notes_name_are_units_of_an_axis_file() -> None:
    for notes in shipped_notes().values():
        for key in notes.axis_file:
            for value in (key.value,) if key.value else key.choices:
                if key.key == "velocity_unit":
                    assert motion_unit(value, AxisScaling(10_000, 10.0), 1).counts > 0


@pytest.mark.parametrize("name", FAMILIES)
def test_each_fact_states_source_and_strength(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "show.json"
    assert main(["drives", "show", name, "--json", str(out)]) == 0
    form, said = json.loads(out.read_text()), capsys.readouterr().out
    assert "verified on hardware  no" in said
    assert all(each["source"] and each["strength"] for each in (*form["registers"].values(), *form["facts"]))
    for texts in form["to_be_proven"].values():
        assert all(text.endswith(("(assumed)", "(general)")) for text in texts)


@pytest.mark.parametrize("name", ["aasd_15a", "kollmorgen_akd2g", "oriental_az", "stepperonline_a6_rs"])
def test_from_a_scan_to_a_proven_axis(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clock = SimClock()
    maker = FAMILIES[name](clock)
    with served(maker) as port:
        assert main(["scan", "--tcp", f"127.0.0.1:{port}", "--units", "1", "--map", name, "--timeout", "10"]) == 0
        assert f"hil drives new X.toml --drive {name} --tcp 127.0.0.1:{port} --unit 1" in capsys.readouterr().out
        scaling = load_drive_map(name).scaling.encoder_counts_per_motor_rev
        counts = () if scaling is not None else ("--counts-per-rev", str(maker.counts_per_rev))
        before = maker.memory()
        status, path = new(tmp_path, name, port, *counts)
        assert status == 0
        assert maker.memory() == before, "nothing is written"
        axis = load_axis(path)
        assert axis.scaling.encoder_counts_per_motor_rev == maker.counts_per_rev
        assert axis.uncertainty is not None, "else a verification at its end decides nothing"
        assert axis.correction.accuracy_limit_um == 10.0
        assert not axis.drive.is_simulated
        text = path.read_text(encoding="utf-8")
        assert "accuracy_limit_um = 10.0    # assumed" in text
        assert "[uncertainty]    # ASSUMED" in text
        endpoint = modbus_endpoint(axis)
        drive = ModbusDrive(
            axis.name,
            axis.scaling,
            axis.limits,
            clock,
            link=ModbusLink(endpoint, clock),
            unit=axis.drive.unit,
            drive_map=load_drive_map(axis.drive.register_map),
            ledger=FactLedger(tmp_path / "facts.json", "here", find_map(name)),
        )
        with AxisSession(drive, Scale(Rig(drive, maker, clock)), HOW) as session:
            assert not failures(doctor(session))
            drive.enable()
            session.move_uncorrected(30.0, 50.0)
            assert abs(maker.servo.position_actual_counts * FEED_MM / maker.counts_per_rev - 30.0) < 0.002
        with connected_drive(axis) as other, pytest.raises(StateError, match="not proven on this drive"):
            other.enable()  # in another store nothing is proven
        assert axis.measurement.home is (load_drive_map(name).homing is not None)
    assert "hil doctor" in capsys.readouterr().out


def test_a_makers_homing_method_is_told_as_such(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with served(LichuanA5(SimClock())) as port:
        assert new(tmp_path, "lichuan_a5", port, "--counts-per-rev", "10000")[0] == 0
    said = capsys.readouterr().out
    assert (
        "homing method 17, by the maker's own numbers (the maker's numbers, 0 to 13): its manual says what it seeks"
        in said
    )
    assert "limit switch" not in said


def test_a_known_value_finds_a_wrong_word_order(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    copy = tmp_path / "mine.toml"
    text = find_map("mitsubishi_mr_je_c").read_text(encoding="utf-8")
    copy.write_text(text.replace('word_order = "little"', 'word_order = "big"'), encoding="utf-8")
    with served(MrJeC(SimClock())) as port:
        known = ("--counts-per-rev", "131072", "--known", f"position={MrJeC.start_counts}")
        status, path = new(tmp_path, str(copy), port, *known)
        assert status == 1
        assert not path.exists()
        assert "it fits word order little at offset +0" in capsys.readouterr().out
        assert new(tmp_path, "mitsubishi_mr_je_c", port, *known)[0] == 0


class UnassignedOutputs(LichuanA5):
    outputs_from_factory = ()


def test_what_a_drive_needs_is_named_with_its_remedy_and_set_up_on_request(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    maker = UnassignedOutputs(SimClock())
    with served(maker) as port:
        status, path = new(tmp_path, "lichuan_a5", port, "--counts-per-rev", "10000")
        assert status == 1
        assert not path.exists()
        said = capsys.readouterr().out
        assert "output_2 reads 0x0, expected 0x9: virtual output 2 is to be brake open; set P17-35 = 9" in said
        assert maker.memory() == maker.found
        assert new(tmp_path, "lichuan_a5", port, "--counts-per-rev", "10000", "--set-up")[0] == 0
        assert [maker[0x1721 + 2 * n] for n in range(5)] == [1, 9, 5, 11, 16]
        assert maker[0x0C0B] == 1


class OtherMode(LeadshineEl7):
    def table(self) -> None:
        super().table()
        self.rows[0x0003].value = 1


def test_a_drive_in_another_mode_is_refused_with_what_to_set(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with served(OtherMode(SimClock())) as port:
        assert new(tmp_path, "leadshine_el7", port)[0] == 1
    assert "set Pr0.01 = 6 and switch the drive off and on" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--drive", "leadshine_el7"), "needs --tcp or --serial; hil scan finds the drive (38400 8N2, unit 1"),
        (("--drive", "nobody", "--tcp", "127.0.0.1"), "neither a file nor a shipped register map"),
        (("--drive", "canopen"), "needs --channel and --node"),
    ],
)
def test_what_is_missing_is_asked_for_by_name(
    arguments: tuple[str, ...], words: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["drives", "new", str(tmp_path / "X.toml"), *arguments]) == 2
    assert words in capfd.readouterr().err


def test_a_missing_answer_is_asked_for_by_its_option(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with served(DeltaAsdaA2(SimClock())) as port:
        arguments = ["--drive", "delta_asda_a2", "--tcp", f"127.0.0.1:{port}", "--travel=0,100", "--max-velocity", "10"]
        assert main(["drives", "new", str(tmp_path / "X.toml"), *arguments]) == 2
    assert "--max-acceleration is missing, expected greatest acceleration" in capfd.readouterr().err
    assert not (tmp_path / "X.toml").exists()


def test_a_gear_is_kept_as_a_fraction(tmp_path: Path) -> None:
    with served(DeltaAsdaA2(SimClock())) as port:
        status, path = new(tmp_path, "delta_asda_a2", port, "--gear", "7/3")
    assert status == 0
    assert load_axis(path).scaling.motor_revs_per_shaft_rev == Fraction(7, 3)
    text = path.read_text()
    assert "encoder_counts_per_motor_rev = 100000    # read from the drive" in text
    assert "# as you gave it" in text


def test_an_axis_file_that_exists_is_kept(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "X.toml").write_text("mine")
    assert new(tmp_path, "leadshine_el7", 1)[0] == 2
    assert "exists already" in capfd.readouterr().err
    assert (tmp_path / "X.toml").read_text() == "mine"


@pytest.mark.outside  # real time-outs
def test_a_wrong_node_id_is_named_with_its_channel_and_who_is_there(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    channel = "first contact"
    with served_can(SimulatedServo(BareShaft()), WallClock(), channel=channel, node_id=7):
        arguments = ["--drive", "canopen", "--interface", "virtual", "--channel", channel, "--node", "9", *KNOWN]
        assert main(["drives", "new", str(tmp_path / "Y.toml"), *arguments, "--instrument-port", "/dev/null"]) == 1
        assert "node 9 does not answer on first contact; a scan found 7" in capfd.readouterr().err
        arguments[arguments.index("9")] = "7"
        assert main(["drives", "new", str(tmp_path / "Y.toml"), *arguments, "--instrument-port", "/dev/null"]) == 0
        path = tmp_path / "Y.toml"
        path.write_text(path.read_text().replace("node_id = 7", "node_id = 9"))
        assert main(["doctor", str(path)]) == 1
        assert "looked for node 9 on first contact; a scan found 7" in capfd.readouterr().err


def on_virtual_bus(channel: str) -> list[str]:
    """Arguments of `drives new` for node 7 of a virtual CAN bus."""
    bus = ["--interface", "virtual", "--channel", channel, "--node", "7"]
    return [*bus, *KNOWN, "--instrument-port", "/dev/null"]


@pytest.mark.parametrize(
    ("name", "simulated"),
    [("Simulated feed axis servo drive", True), ("EPOS4 Module 50/15", False), ("not Simulated at all", False)],
)
def test_a_simulated_drive_is_known_by_its_name_so_that_certificates_say_so(
    tmp_path: Path, name: str, simulated: bool
) -> None:
    channel, path = "drives by name", tmp_path / "Y.toml"
    with served_can(SimulatedServo(BareShaft()), WallClock(), channel=channel, node_id=7) as slave:
        slave.dictionary.set_raw((0x1008, 0), name.encode())
        where = on_virtual_bus(channel)
        assert main(["drives", "new", str(path), "--drive", "canopen", *where]) == 0
    assert load_axis(path).drive.is_simulated is simulated


def test_a_simulated_drive_is_known_by_its_name_over_modbus_too(tmp_path: Path) -> None:
    with tcp_server({1: Cia402Registers(SimulatedServo(BareShaft()))}, WallClock()) as (_, port):
        status, path = new(tmp_path, "cia402_over_modbus", port)
    assert status == 0
    assert load_axis(path).drive.is_simulated


@pytest.mark.outside  # real time-outs
def test_a_wrong_unit_is_named_with_who_is_there(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with tcp_server({3: VendorRegisters(SimulatedServo(BareShaft()), counts_per_rev=10_000)}, WallClock()) as (_, port):
        status, _ = new(tmp_path, "vendor_style", port, "--counts-per-rev", "10000", "--unit", "5", "--timeout", "1")
    assert status == 1
    said = capfd.readouterr().err
    assert "a scan found unit 3" in said
    assert f"127.0.0.1:{port}" in said


def test_notes_ask_for_what_the_drive_does_not_say_and_are_refused_for_another_maker(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    channel, path = "notes of drives", tmp_path / "Y.toml"
    trinamic = {(0x1018, 1): 0x286}
    with served_can(SimulatedServo(BareShaft()), WallClock(), channel=channel, node_id=7, parameters=trinamic):
        where = on_virtual_bus(channel)

        def new_with(name: str, *more: str) -> tuple[int, str]:
            status = main(["drives", "new", str(path), "--drive", name, *where, *more])
            said = capfd.readouterr()
            return status, said.out + said.err

        status, said = new_with("maxon_epos4")
        assert status == 1
        assert (
            "maxon is vendor FBh, node 7 is of 286h: this is no maxon_epos4; use --drive trinamic_tmcm or canopen"
            in said
        )
        status, said = new_with("trinamic_tmcm")
        assert status == 2
        assert "--velocity-unit is missing, expected rpm or counts/s: modules of this maker take" in said
        status, said = new_with("leadshine_2cs3e")
        assert status == 2
        assert "--axis is missing, expected 1 or 2: two axes are in this node" in said
        status, said = new_with("canopen", "--velocity-unit", "furlongs")
        assert status == 2
        assert "furlongs" in said
        assert not path.exists()
        status, said = new_with("trinamic_tmcm", "--velocity-unit", "counts/s")
        assert status == 0
        assert "noted of this drive (maker): no object says what velocities are in" in said
    axis = load_axis(path)
    assert axis.drive.velocity_unit == "counts/s"
    assert "# noted of this drive (maker): 6084h is read-only" in path.read_text()
