"""`hil doctor` as a user types it where the drive is on Modbus: every face, and the search for a word order."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support import bench_axis

from drivers.clock import WallClock
from drivers.modbus.register_map import shipped_maps
from hil.app.main import main
from sim_backends.bare_shaft import BareShaft
from sim_backends.modbus_drive import ModbusServer, tcp_server
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import SimulatedServo

TARGET = 0x12345678
WRITES = (5, 6, 15, 16)


@pytest.mark.parametrize(
    "drive",
    [
        'face = "virtual"',
        'face = "modbus-tcp"',
        'face = "modbus-rtu"',
        'face = "modbus-rtu"\nregister_map = "vendor_style"',
    ],
)
def test_a_sound_axis_is_found_good_over_every_face(drive: str, tmp_path: Path) -> None:
    path = bench_axis.lay_out(tmp_path)
    path.write_text(path.read_text().replace("[drive]", f"[drive]\n{drive}"))
    assert main(["doctor", str(path), "--json", str(tmp_path / "doctor.json")]) == 0
    names = [check["name"] for check in json.loads((tmp_path / "doctor.json").read_text())["checks"]]
    own = ["drive's table"] if "modbus" in drive else []  # both register maps tell of one
    motion = [] if "modbus" in drive or "virtual" in drive else ["units of motion"]  # a register map states them itself
    order = ["word order"] if "modbus" in drive else []
    assert names == ["drive", "limits", "scaling", *motion, *order, "zero", *own, "instrument", "speed", "units"]


@pytest.fixture
def server() -> Iterator[tuple[ModbusServer, int]]:
    face = VendorRegisters(SimulatedServo(BareShaft()), counts_per_rev=1_000_000)
    face._motion["target"] = TARGET
    with tcp_server({1: face}, WallClock()) as found:
        yield found


def axis_on(port: int, tmp_path: Path, *, word_order: str = "little", state_address: str = "10003") -> Path:
    """An axis with the vendor's map in a file of its own, which may be wrong."""
    text = shipped_maps()["vendor_style"].read_text(encoding="utf-8")
    text = text.replace('word_order = "little"', f'word_order = "{word_order}"')
    (tmp_path / "mine.toml").write_text(text.replace("address = 10003", f"address = {state_address}"), encoding="utf-8")
    path = bench_axis.lay_out(tmp_path)
    drive = f'backend = "modbus"\nregister_map = "mine.toml"\nurl = "tcp://127.0.0.1:{port}?timeout_s=10"'
    text = path.read_text().replace('backend = "bench"\nmachine = "geometric"\nseed = 5', drive)
    path.write_text(text.replace("[instrument]", '[instrument]\nport = "/nowhere"'))
    return path


def probe(path: Path, *arguments: str) -> tuple[int, dict[str, Any]]:
    out = path.with_name("probe.json")
    status = main(["doctor", str(path), "--probe-order", *arguments, "--json", str(out)])
    return status, json.loads(out.read_text())


def test_a_right_map_is_confirmed(server: tuple[ModbusServer, int], tmp_path: Path) -> None:
    status, found = probe(axis_on(server[1], tmp_path), f"target={TARGET}")
    assert status == 0
    (match,) = [match for match in found["matches"] if match["type"] == "i32"]
    assert match == {
        "address": 0,
        "offset": 0,
        "type": "i32",
        "word_order": "little",
        "byte_order": "big",
        "value": TARGET,
        "as_mapped": True,
    }
    assert not any(pdu[0] in WRITES for _, pdu in server[0].seen)


def test_a_wrong_word_order_is_found_out(
    server: tuple[ModbusServer, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, found = probe(axis_on(server[1], tmp_path, word_order="big"), f"target={TARGET - 20}", "--tolerance", "50")
    assert status == 1
    (match,) = [match for match in found["matches"] if match["type"] == "i32"]
    assert (match["word_order"], match["as_mapped"]) == ("little", False)
    assert "target is mapped wrongly" in capsys.readouterr().out


def test_a_map_too_wrong_to_read_a_state_can_be_probed_all_the_same(
    server: tuple[ModbusServer, int], tmp_path: Path
) -> None:
    path = axis_on(server[1], tmp_path, state_address="19999")
    assert main(["doctor", str(path), "--no-move"]) == 1
    assert probe(path, f"target={TARGET}")[0] == 0


def test_a_value_that_is_nowhere_is_told(
    server: tuple[ModbusServer, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    status, found = probe(axis_on(server[1], tmp_path), "target=424242")
    assert (status, found["matches"]) == (1, [])
    assert "not found there" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("target", "expected REGISTER=VALUE"),
        ("target=", "expected REGISTER=VALUE"),
        ("target=nan", "expected REGISTER=VALUE"),
        ("nowhere=5", "has no register 'nowhere'"),
    ],
)
def test_what_cannot_be_probed_is_refused(
    argument: str,
    words: str,
    server: tuple[ModbusServer, int],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    assert main(["doctor", str(axis_on(server[1], tmp_path)), "--probe-order", argument]) == 2
    assert words in capfd.readouterr().err


def test_an_axis_without_registers_cannot_be_probed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", str(bench_axis.lay_out(tmp_path)), "--probe-order", "x=1"]) == 2
    assert "is not on Modbus" in capfd.readouterr().err


def test_an_instrument_port_that_cannot_be_opened_names_the_instrument_and_not_the_drive(
    server: tuple[ModbusServer, int], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", str(axis_on(server[1], tmp_path))]) == 1
    said = capfd.readouterr().err
    assert "instrument umd ([instrument] of the axis file): port /nowhere cannot be opened" in said
    assert "is the adapter plugged in" in said
    assert "looked for" not in said
