"""`hil scan` as a user types it: against Modbus servers on loopback and a pty, and an slcan adapter on a pty."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.served_drive import served
from support.sim_process import sim

from drivers.clock import WallClock
from hil.app.main import main
from hil.files.scan import parse_ids
from sim_backends.bare_shaft import BareShaft
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import ModbusServer, rtu_slave, tcp_server
from sim_backends.modbus_registers import Face
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo

WRITES = (5, 6, 15, 16, 22, 23)
FAULT = 0x7305
PATIENT = ("--timeout", "10")  # where everybody answers, if the host lets them


def vendor(position_counts: float = 0.0, fault: int = 0) -> Face:
    servo = SimulatedServo(BareShaft(), ServoParameters(start_counts=position_counts))
    servo.fault_code = fault
    return VendorRegisters(servo, counts_per_rev=1_000_000)


@contextmanager
def scanned(tmp_path: Path) -> Iterator[Callable[..., tuple[int, list[dict[str, Any]]]]]:
    def scan(*arguments: str) -> tuple[int, list[dict[str, Any]]]:
        out = tmp_path / "scan.json"
        status = main(["scan", *arguments, "--json", str(out)])
        return status, next(iter(json.loads(out.read_text()).values()))

    yield scan


def nothing_written(server: ModbusServer) -> bool:
    return bool(server.seen) and not any(pdu[0] in WRITES for _, pdu in server.seen)


def test_units_behind_a_gateway_are_found_with_their_state(tmp_path: Path) -> None:
    faces: Mapping[int, Face] = {3: vendor(1234.0), 11: vendor(fault=FAULT)}
    with tcp_server(faces, WallClock()) as (server, port), scanned(tmp_path) as scan:
        status, units = scan("--tcp", f"127.0.0.1:{port}", "--map", "vendor_style", *PATIENT)
        assert status == 0
        assert [(unit["unit"], unit["state"], unit["position_raw"], unit["fault_code"]) for unit in units] == [
            (3, "switch on disabled", 1234, None),
            (11, "fault", 0, FAULT),
        ]
        assert nothing_written(server)
        status, units = scan("--tcp", f"tcp://127.0.0.1:{port}", "--units", "11-12,3", *PATIENT)
        assert [(unit["unit"], unit["refusal"], unit["state"]) for unit in units] == [(3, "", None), (11, "", None)]


def test_a_map_that_does_not_fit_says_so_and_the_unit_is_there_all_the_same(tmp_path: Path) -> None:
    with tcp_server({1: vendor()}, WallClock()) as (_, port), scanned(tmp_path) as scan:
        status, (unit,) = scan("--tcp", f"127.0.0.1:{port}", "--map", "cia402_over_modbus", "--units", "1", *PATIENT)
        assert status == 0
        assert unit["problem"].startswith("does not fit the register map: ")
        assert unit["state"] is None


@pytest.mark.outside  # real time-outs
def test_units_on_a_serial_line_are_found_and_silence_is_nobody(tmp_path: Path) -> None:
    face = Cia402Registers(SimulatedServo(BareShaft()))
    with rtu_slave({2: face}, WallClock()) as (server, path), scanned(tmp_path) as scan:
        line = ("--serial", f"{path}?parity=N", "--baud", "115200", "--timeout", "1")
        status, units = scan(*line, "--units", "2-3", "--map", "cia402_over_modbus")
        assert status == 0
        assert [(unit["unit"], unit["state"]) for unit in units] == [(2, "switch on disabled")]
        assert nothing_written(server)
        assert scan(*line, "--units", "7") == (1, [])


def test_a_server_that_answers_every_unit_is_told_for_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    face = vendor()
    with tcp_server(dict.fromkeys(range(1, 17), face), WallClock()) as (_, port):
        assert main(["scan", "--tcp", f"127.0.0.1:{port}", *PATIENT]) == 0
    assert "is one device" in capsys.readouterr().out


@pytest.mark.outside  # real time-outs
def test_nodes_of_a_can_bus_are_found_and_a_listener_hears_them(tmp_path: Path) -> None:
    channel = f"scan-{tmp_path}"
    with (
        served(SimulatedServo(BareShaft()), WallClock(), channel=channel, node_id=7),
        served(SimulatedServo(BareShaft()), WallClock(), channel=channel, node_id=12, parameters={(0x1017, 0): 50}),
        scanned(tmp_path) as scan,
    ):
        bus = ("--interface", "virtual", "--channel", channel)
        status, nodes = scan(*bus, "--nodes", "6-13", "--timeout", "2")
        assert status == 0
        assert [(node["node_id"], node["state"], node["device_type"] & 0xFFFF) for node in nodes] == [
            (7, "switch on disabled", 402),
            (12, "switch on disabled", 402),
        ]
        status, nodes = scan(*bus, "--listen", "0.5")
        assert [(node["node_id"], node["nmt_state"], node["answers_sdo"]) for node in nodes] == [
            (12, "pre_operational", False)
        ]
        assert threading.active_count() >= 3


@pytest.mark.outside  # real time-outs
def test_a_drive_process_is_found_through_a_serial_can_adapter(tmp_path: Path) -> None:
    with sim("drive", "--interface", "slcan-pty", "--node", "42") as machine, scanned(tmp_path) as scan:
        place = machine.place["drive"]
        bus = ("--interface", place["interface"], "--channel", place["channel"], "--bitrate", "1000000")
        status, (node,) = scan(*bus, "--nodes", "40-44", "--timeout", "2")
        assert status == 0
        assert (node["node_id"], node["state"], node["position_counts"]) == (42, "switch on disabled", 0)


def exit_status(arguments: list[str]) -> object:
    try:
        return main(arguments)
    except SystemExit as ended:
        return ended.code


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        ([], 2, "one of the arguments"),
        (["--channel", "x", "--tcp", "y"], 2, "not allowed with"),
        (["--tcp", "127.0.0.1:1", "--units", "0-3", "--timeout", "0.2"], 1, "cannot be opened"),
        (["--tcp", "127.0.0.1:1", "--units", "1-300"], 2, "--units is '1-300', expected ids 0 to 255"),
        (["--serial", "/dev/null", "--units", "0"], 2, "expected ids 1 to 247"),
        (["--channel", "x", "--nodes", "0-5"], 2, "--nodes is '0-5', expected ids 1 to 127"),
        (["--channel", "x", "--nodes", "five"], 2, "expected ids such as"),
        (["--channel", "x", "--listen", "0"], 2, "--listen is 0"),
        (["--channel", "x", "--interface", "nonsense"], 1, "python-can has no such interface, but "),
        (["--channel", "0", "--interface", "kvaser"], 1, "install Kvaser's driver with CANlib, or use socketcan"),
        (["--channel", "0", "--interface", "ixxat"], 1, "install HMS' IXXAT VCI driver"),
        (
            ["--channel", "can0", "--interface", "socketcand"],
            1,
            "it also needs host and port: write them to ~/can.conf",
        ),
        (["--channel", "/dev/nowhere", "--interface", "slcan"], 1, "is the adapter plugged in"),
        (["--serial", "/dev/nowhere"], 1, "is the adapter plugged in"),
        (["--tcp", "127.0.0.1:1", "--timeout", "0"], 2, "--timeout is 0"),
        (["--tcp", "127.0.0.1:1", "--map", "nonsense"], 2, "shipped register map"),
    ],
)
def test_what_cannot_be_is_one_line(
    arguments: list[str], status: int, words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert exit_status(["scan", *arguments]) == status
    error = capfd.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_ids_as_they_are_typed() -> None:
    assert parse_ids("5,1-3, 2", "--units", 1, 10) == [1, 2, 3, 5]
