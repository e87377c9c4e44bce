"""`hil probe codes` as a user types it: a control's codes over CANopen and Modbus, and at I/O modules beside the drives."""

from __future__ import annotations

import json
import uuid
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import canopen
import pytest
from support import probe_files
from support.served_drive import served

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.clock import WallClock
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from hil.app.main import main
from hil.probe.machine_file import load_probe_machine
from hil.probe.wiring import control_wires
from sim_backends.bare_shaft import SMALL_SERVO, BareShaft
from sim_backends.control_wires import Wires
from sim_backends.modbus_drive import tcp_server
from sim_backends.modbus_registers import Bank, Cell, Space
from sim_backends.servo import SimulatedServo

WIRES = 'drive = "{drive}"\nstrobe_bit = 20\ncode_bits = [21, 22]\nalive_bit = 23'
QUICK = "touch_mm_s = 20.0\nposition_mm_s = 50.0"
TRUE_X_UM, TRUE_Y_UM = -63.49, -16.63  # of seed 4, as the verb itself says of the simulated machine


def machine(tmp_path: Path, face: str, program: str, codes: str = "", *, drive: str = "x", block: str = "") -> Path:
    more = f"[codes]\n{WIRES.format(drive=drive)}\n{codes}\n[bench]\nseed = 4\nprogram = {program}"
    return probe_files.lay_out(
        tmp_path, drive=face, start_mm=102.6, search_mm=1.0, probe=QUICK, block=f"turns = 1\n{block}", more=more
    )


@pytest.mark.parametrize(
    ("face", "drive"),
    [
        (probe_files.CANOPEN, "spindle"),
        pytest.param(probe_files.MODBUS, "x", marks=pytest.mark.outside),
        (probe_files.VIRTUAL, "y"),
    ],
    ids=["canopen", "modbus", "virtual"],
)
def test_a_control_measures_and_corrects(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], face: str, drive: str
) -> None:
    path, out = machine(tmp_path, face, "[90, 91, 92]", drive=drive), tmp_path / "out.json"
    assert main(["probe", "codes", str(path), "--times", "3", "--wait", "20", "--json", str(out)]) == 0
    said = capsys.readouterr().out
    assert said.count("MFIN given") == 3
    handled = json.loads(out.read_text())["handled"]
    assert [one["code"] for one in handled] == ["M90", "M91", "M92"]
    x_mm, y_mm = handled[0]["run_out"]["x_mm"], handled[0]["run_out"]["y_mm"]
    assert (1000 * x_mm, 1000 * y_mm) == pytest.approx((TRUE_X_UM, TRUE_Y_UM), abs=1.0)
    assert handled[1]["driven_mm"] == pytest.approx([x_mm, 0.0], abs=1e-5)
    assert handled[2]["driven_mm"] == pytest.approx([0.0, y_mm], abs=1e-5)
    assert json.loads((tmp_path / "mill-probe/runout.json").read_text())["x_mm"] == x_mm


def test_a_refused_run_out_ends_it_with_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = machine(tmp_path, probe_files.CANOPEN, "[90, 91]", block="closure_limit_um = 0.000001")
    assert main(["probe", "codes", str(path), "--times", "2"]) == 1
    seen = capsys.readouterr()
    assert "M90 gets no MFIN: the contacts do not close" in seen.err
    assert "MFIN given" not in seen.out


def test_a_dry_run_says_codes_and_wires(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = machine(tmp_path, probe_files.CANOPEN, "[]", "both = 91\nx = 92\ny = 93")
    assert main(["probe", "codes", str(path), "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert "M90 measures, M92 corrects X, M93 Y, M91 both" in said
    assert "wires at X: strobe input 20, code on inputs 21, 22 (binary), MFIN output 16" in said
    assert not (tmp_path / "mill-probe").exists()


def test_without_wires_and_with_a_code_that_there_is_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = probe_files.lay_out(tmp_path, more="[codes]\nx = 95")
    assert main(["probe", "codes", str(path)]) == 2
    assert "lacks [codes] drive" in capsys.readouterr().err
    assert main(["probe", "correct", str(path), "--code", "M91"]) == 2
    assert "code is M91, expected one of M95, M92, M93" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("bit", "said"),
    [(0, "give coil 0, which is servo_on of drive S"), (16, "drive S has no inputs and outputs for a control")],
)
def test_a_drive_without_terminals_and_a_coil_that_would_switch_it_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bit: int, said: str
) -> None:
    path = machine(tmp_path, probe_files.VIRTUAL, "[90]", f"mfin_bit = {bit}", drive="spindle")
    spindle = tmp_path / "S.toml"
    spindle.write_text(spindle.read_text().replace(probe_files.VIRTUAL, probe_files.VENDOR))
    assert main(["probe", "codes", str(path), "--times", "1", "--wait", "5"]) == 2
    assert said in capsys.readouterr().err


def test_mfin_leaves_a_drives_other_outputs_and_their_mask_as_they_were(tmp_path: Path) -> None:
    """60FEh: of outputs 17 (on) and 18 (off) both are enabled, and MFIN, 16, is not until it is used."""
    config = load_probe_machine(machine(tmp_path, probe_files.VIRTUAL, "[]"))
    channel, clock = uuid.uuid4().hex, WallClock()
    with (
        served(SimulatedServo(BareShaft(), SMALL_SERVO), clock, channel=channel, node_id=3) as slave,
        CanLink.open(clock, interface="virtual", channel=channel) as link,
    ):
        outputs = {1: 1 << 17, 2: 0b110 << 16}
        for subindex, value in outputs.items():
            slave.dictionary.set_number(0x60FE, subindex, value)
        axis, patient = config.x, CanOpenSettings(sdo_timeout_s=10.0, heartbeat_s=None)
        with CanOpenDrive("X", axis.scaling, axis.limits, clock, link=link, node_id=3, settings=patient) as drive:
            with control_wires(config, {"x": drive}) as wires:
                wires.set_mfin(True)
                assert wires.mfin()
                assert slave.profile.wires.outputs == 0b011 << 16
                slave.profile.wires.inputs = 1 << 20
                assert wires.inputs() >> 20 & 1
            assert {subindex: slave.dictionary.number(0x60FE, subindex) for subindex in outputs} == outputs
            assert slave.profile.wires.outputs == 1 << 17


def test_an_io_module_of_another_stack_on_the_can_bus(tmp_path: Path) -> None:
    """CiA 401, 6000h and 6200h, served by the library canopen."""
    path = machine(tmp_path, probe_files.VIRTUAL, "[]", "station = 9\nmfin_bit = 10").read_text()
    wires_at = path.replace("strobe_bit = 20", "strobe_bit = 4").replace("[21, 22]", "[5, 14]")
    (tmp_path / "mill.toml").write_text(wires_at.replace("alive_bit = 23", "alive_bit = 7"))
    config = load_probe_machine(tmp_path / "mill.toml")
    dictionary = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
    for index in (0x6000, 0x6200):
        record = canopen.objectdictionary.ODArray("module", index)
        for subindex in range(3):
            entry = canopen.objectdictionary.ODVariable(f"{subindex}", index, subindex)
            entry.data_type, entry.access_type, entry.default = canopen.objectdictionary.UNSIGNED8, "rw", 0
            record.add_member(entry)
        dictionary.add_object(record)
    channel, network = uuid.uuid4().hex, canopen.Network()
    network.NOTIFIER_CYCLE = 0.05  # it ends after one more
    network.connect(interface="virtual", channel=channel)
    try:
        module = network.create_node(9, dictionary)
        module.sdo[0x6000][1].raw = 1 << 4 | 1 << 7
        module.sdo[0x6000][2].raw = 1 << 6
        module.sdo[0x6200][2].raw = 1 << 7
        clock = WallClock()
        with CanLink.open(clock, interface="virtual", channel=channel) as link:
            link.listen()
            drive = CanOpenDrive("X", config.x.scaling, config.x.limits, clock, link=link, node_id=3)
            with control_wires(config, {"x": drive}) as wires:
                assert wires.inputs() == 1 << 4 | 1 << 7 | 1 << 14
                wires.set_mfin(True)
                assert wires.mfin()
                assert module.sdo[0x6200][2].raw == 1 << 7 | 1 << 2
            assert module.sdo[0x6200][2].raw == 1 << 7
    finally:
        network.disconnect()


class _Module:
    """A Modbus I/O module: four discrete inputs from 100, two coils from 200."""

    max_read = max_write = 16
    single_writes = True

    def __init__(self) -> None:
        self.wires = Wires(inputs=0b1010)
        inputs = [Cell(100 + bit, "?", lambda bit=bit: self.wires.inputs >> bit & 1) for bit in range(4)]  # type: ignore[misc]
        coils = [Cell(200, "?", lambda: self.wires.outputs, self._switch), Cell(201, "?", lambda: 0)]
        self.banks = {
            Space.DISCRETE_INPUTS: Bank(inputs, gaps_readable=False),
            Space.COILS: Bank(coils, gaps_readable=False),
        }

    def _switch(self, level: object) -> None:
        self.wires.outputs = int(bool(level))

    def tick(self, now_ns: int) -> None:
        del now_ns

    def bearable(self, now_ns: int) -> int:
        del now_ns
        return 1_000_000_000


def test_an_io_module_on_the_modbus_line(tmp_path: Path) -> None:
    config = load_probe_machine(machine(tmp_path, probe_files.VIRTUAL, "[]"))
    codes = replace(config.codes, station=7, strobe_bit=1, code_bits=(2, 3), alive_bit=None, mfin_bit=0)
    config = replace(config, codes=replace(codes, inputs_start=100, outputs_start=200))
    module, clock = _Module(), WallClock()
    with ExitStack() as stack:
        _, port = stack.enter_context(tcp_server({7: module}, clock))
        link = ModbusLink(TcpEndpoint("127.0.0.1", port, timeout_s=5.0), clock)
        link.open()
        stack.callback(link.close)
        axis = config.x
        drive = ModbusDrive(
            "X", axis.scaling, axis.limits, clock, link=link, unit=1, drive_map=load_drive_map("cia402_over_modbus")
        )
        with control_wires(config, {"x": drive}) as wires:
            assert wires.inputs() == 0b1010
            wires.set_mfin(True)
            assert wires.mfin()
            assert module.wires.outputs == 1
        assert module.wires.outputs == 0
