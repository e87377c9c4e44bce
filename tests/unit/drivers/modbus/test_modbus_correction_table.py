"""A Modbus drive's own table: what its map may say of it, and blocks of registers against the simulated drives' own."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest
from support.modbus_direct import DirectWire

from drivers.correction_table import Directions, Interpolation, Nodes, Outside, RawFormat, RawTable
from drivers.errors import AbortError, InputError, ProtocolError, StateError
from drivers.modbus.correction_table import ModbusCorrectionTable
from drivers.modbus.endpoint import Endpoint, TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.register_map import find_map
from drivers.modbus.wear import WearLedger
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_registers import Face
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import SimulatedServo

Made = tuple[ModbusCorrectionTable, DirectWire, SimulatedServo, WearLedger]


def made(name: str) -> Made:
    servo = SimulatedServo(BareShaft())
    face: Face = VendorRegisters(servo, counts_per_rev=1000) if name == "vendor_style" else Cia402Registers(servo)
    wire = DirectWire(face)
    clock = SimClock()

    def make_wire(_endpoint: Endpoint) -> DirectWire:
        return wire

    link = ModbusLink(TcpEndpoint("nowhere"), clock, make_wire=make_wire)
    link.open()
    drive_map = load_drive_map(name)
    assert drive_map.table is not None
    ledger = WearLedger()
    access = RegisterAccess(link, 1, drive_map.registers)
    return ModbusCorrectionTable("X", access, drive_map.table, ledger), wire, servo, ledger


def contents(name: str, points: int, seed: int = 1) -> RawTable:
    generator = random.Random(seed)
    values, others = (tuple(generator.randint(-30_000, 30_000) for _ in range(points)) for _ in range(2))
    if name == "vendor_style":
        return RawTable(values, (), (), -70_000, 123_456, 321)
    return RawTable(values, others, tuple(-500 + 70_000 * place for place in range(points)))


both = pytest.mark.parametrize(
    ("name", "most", "most_write"), [("cia402_over_modbus", 128, 123), ("vendor_style", 256, 16)]
)


@both
def test_what_is_written_is_read_back_in_requests_that_the_drive_bears(name: str, most: int, most_write: int) -> None:
    table, wire, servo, _ = made(name)
    assert (table.read(), table.enabled()) == (RawTable(), False)
    wanted = contents(name, most)
    table.write(wanted)
    writes = [count for function, count in wire.seen if function in (6, 16)]
    assert max(writes) <= most_write
    assert len(writes) <= -(-most * (5 if name.startswith("cia402") else 1) // (most_write - 1)) + 6
    assert table.read() == wanted
    table.switch(True)
    assert table.enabled()
    with pytest.raises(AbortError):  # not while it corrects
        table.write(contents(name, 3), wanted)
    servo.power_on()
    with pytest.raises(AbortError):
        table.switch(False)


@both
def test_only_what_differs_is_written(name: str, most: int, most_write: int) -> None:
    table, wire, _, _ = made(name)
    old = contents(name, 40)
    table.write(old)
    wire.seen.clear()
    table.write(old, old)
    assert wire.seen == []
    new = RawTable((*old.plus[:7], 5, *old.plus[8:]), old.minus, old.position, old.origin, old.step, old.backlash)
    table.write(new, old)
    assert wire.seen == [(6, 1)]
    assert table.read() == new


def test_eeprom_is_spared_and_its_budget_kept() -> None:
    table, _, _, ledger = made("vendor_style")
    assert table.changes_left() == 20
    old = RawTable()
    for change in range(20):
        new = contents("vendor_style", 5, change)
        table.write(new, old)
        old = new
    assert ledger.writes("X", "pitch_value") == 20
    assert table.changes_left() == 0
    with pytest.raises(StateError, match="budget is 20"):
        table.write(contents("vendor_style", 5, 99), old)
    assert made("cia402_over_modbus")[0].changes_left() is None


def test_a_count_that_cannot_be_is_said() -> None:
    table, wire, _, _ = made("cia402_over_modbus")
    face = wire.face
    assert isinstance(face, Cia402Registers)
    face.table.numbers["count"] = 129
    with pytest.raises(ProtocolError, match="says it holds 129 points, its map 128"):
        table.read()


# -- the map -----------------------------------------------------------------------------------------------------------
def test_the_shipped_maps_say_what_the_tables_are() -> None:
    error_map, pitch = (load_drive_map(name).table for name in ("cia402_over_modbus", "vendor_style"))
    assert error_map is not None
    assert pitch is not None
    found = error_map.description
    assert (found.nodes, found.outside, found.directions) == (Nodes.EXPLICIT, Outside.ZERO, Directions.BOTH)
    assert found.position == RawFormat("um", 1.0, -(2**31), 2**31 - 1)
    assert found.value == RawFormat("um", 0.05, -32768, 32767)
    assert (found.shows_applied, found.wears) == (True, False)
    found = pitch.description
    assert (found.nodes, found.interpolation, found.directions) == (
        Nodes.EQUIDISTANT,
        Interpolation.STEP,
        Directions.BACKLASH,
    )
    assert (found.shows_applied, found.wears) == (False, True)
    assert found.backlash == RawFormat("counts", 1.0, 0, 65535)
    for name in ("pitch_value", "pitch_active", "pitch_points"):
        assert name in load_drive_map("vendor_style").moving(), "no parameter of its own"


Change = Callable[[str], str]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('interpolation = "step"\n', 'interpolation = "cubic"\n', "interpolation is cubic, expected linear or step"),
        ("sign = 1\n", "sign = 2\n", "sign is 2, expected 1 .a positive value is added"),
        ("points = 256\n", "points = 40000\n", "points is 40000, expected a whole number, 1 to 32768"),
        ('origin = "pitch_origin"\n', "", "correction_table. lacks origin"),
        ('plus = "pitch_value"\n', 'plus = "pitch"\n', "plus is 'pitch', expected the name of a register"),
        (
            'plus = "pitch_value"\n',
            'plus = "position"\n',
            "plus is 'position', expected whole numbers that are read and written",
        ),
        (
            'plus = "pitch_value"\n',
            'plus = "torque_limit"\n',
            "'torque_limit' in 'percent', expected counts, rev, um, mm",
        ),
        (
            'plus = "pitch_value"\n',
            'plus = "target"\n',
            "plus overlaps 'target_speed': 256 values from 'target' on reach it",
        ),
        ('step = "pitch_step"\n', 'step = "target_speed"\n', "in 'rpm', expected counts, rev, um, mm"),
        ("on = 1, off = 0 }", "on = 1, off = 1 }", "on is 1, off 1, expected two values"),
        (
            "sign = 1\n",
            'sign = 1\nminus = "pitch_value"\n',
            "minus has no use with nodes equidistant, directions backlash",
        ),
        ('nodes = "equidistant"\n', 'nodes = "explicit"\n', "correction_table. lacks position"),
    ],
)
def test_what_cannot_be_a_table_is_refused_with_its_line(old: str, new: str, words: str, tmp_path: Path) -> None:
    head, mark, tail = find_map("vendor_style").read_text(encoding="utf-8").partition("[drive.correction_table]")
    assert old in tail
    path = tmp_path / "map.toml"
    path.write_text(head + mark + tail.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=words) as error:
        load_drive_map(path)
    assert error.value.line is not None
    assert error.value.line > head.count("\n")
