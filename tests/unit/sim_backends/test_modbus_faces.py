"""The simulated drives' register tables against the client's shipped maps, which were written apart from each other."""

from __future__ import annotations

import re
from typing import Any

import pytest
from support.modbus_direct import DirectWire

from drivers.errors import AbortError
from drivers.modbus.codec import Layout, RegisterType, encode
from drivers.modbus.endpoint import Endpoint, TcpEndpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.register_map import Memory, RegisterMap, RegisterRights
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.modbus_cia402 import KEPT, Cia402Registers
from sim_backends.modbus_registers import Face, Space
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo

COUNTS_PER_REV = 60_000  # one count/s is 0.001 rpm


def _access(face: Face, registers: RegisterMap) -> RegisterAccess:
    def wire(_endpoint: Endpoint) -> DirectWire:
        return DirectWire(face)

    link = ModbusLink(TcpEndpoint("nowhere"), SimClock(), make_wire=wire)
    link.open()
    return RegisterAccess(link, 1, registers)


def _servo() -> SimulatedServo:
    return SimulatedServo(BareShaft(), ServoParameters(counts_per_rev=COUNTS_PER_REV, home_switch_counts=-20_000.0))


def _cia402() -> tuple[Cia402Registers, RegisterAccess]:
    face = Cia402Registers(_servo())
    return face, _access(face, load_drive_map("cia402_over_modbus").registers)


def _vendor() -> tuple[VendorRegisters, RegisterAccess]:
    face = VendorRegisters(_servo(), counts_per_rev=COUNTS_PER_REV)
    return face, _access(face, load_drive_map("vendor_style").registers)


_SPACES = {
    "coil": Space.COILS,
    "discrete": Space.DISCRETE_INPUTS,
    "input": Space.INPUT_REGISTERS,
    "holding": Space.HOLDING_REGISTERS,
}


@pytest.mark.parametrize("make", [_cia402, _vendor])
def test_map_and_drive_have_the_same_addresses(make: Any) -> None:
    face, access = make()
    mapped: dict[Space, set[int]] = {}
    for register in access.registers.registers.values():
        mapped.setdefault(_SPACES[register.table.value], set()).update(range(register.span.start, register.span.end))
    table = load_drive_map(access.registers.path).table
    assert table is not None
    for first in table.columns.values():
        end = first.span.start + table.description.points * first.span.count
        mapped[_SPACES[first.table.value]].update(range(first.span.start, end))
    if make is _cia402:  # its terminals are no registers of the map: a machine file names them by address
        mapped |= {Space.DISCRETE_INPUTS: set(range(32)), Space.COILS: set(range(32))}
    assert mapped == {space: set(bank.addresses) for space, bank in face.banks.items()}


@pytest.mark.parametrize("make", [_cia402, _vendor])
def test_everything_readable_can_be_read_at_once_and_the_rest_is_refused(make: Any) -> None:
    _, access = make()
    names = [name for name, register in access.registers.registers.items() if register.readable]
    values = access.read(names)
    assert set(values) == set(names)
    for name in names:
        assert access.read([name])[name] == values[name]


@pytest.mark.parametrize("make", [_cia402, _vendor])
def test_access_rights_agree(make: Any) -> None:
    _, access = make()
    for name, register in access.registers.registers.items():
        words = access.words([name])[name] if register.readable else (0,) * register.span.count
        if register.access is RegisterRights.RO and register.table.is_writable:
            with pytest.raises(AbortError) as caught:
                access.link.write(1, register.table, register.span.start, words)
            assert caught.value.code == 2, name
        elif register.access is RegisterRights.RW:
            access.link.write(1, register.table, register.span.start, words)


def test_every_object_stands_where_the_map_says() -> None:
    face, access = _cia402()
    checked = 0
    for name, register in access.registers.registers.items():
        match = re.match(r"([0-9A-F]{4})h(?::(\d))?", register.description)
        if match is None or not register.readable or register.layout.type is RegisterType.STRING:
            continue
        index, subindex = int(match[1], 16), int(match[2] or 0)
        if register.writable and index not in (0x6040, 0x6060):
            marker = 7 + checked if register.maximum is None else round(register.maximum / register.scale)
            if index == 0x60B8:
                marker = 0x3121  # a source it does not have would be refused
            access.write({name: marker})
            assert face.dictionary.number(index, subindex) == marker, name
        assert access.integers([name])[name] == face.dictionary.number(index, subindex), name
        checked += 1
    assert checked >= 49


def test_wide_objects_keep_sign_and_word_order() -> None:
    face, access = _cia402()
    access.write({"target_position": -123_456_789})
    assert face.dictionary.number(0x607A) == -123_456_789
    access.write({"homing_method": -3})
    assert face.dictionary.number(0x6098) == -3
    with pytest.raises(AbortError) as caught:
        access.write({"homing_method": 38})
    assert caught.value.code == 3


def test_kept_objects_agree_with_the_map() -> None:
    _, access = _cia402()
    in_map = {
        int(register.description[:4], 16)
        for register in access.registers.registers.values()
        if register.memory is Memory.EEPROM and re.match(r"[0-9A-F]{4}h", register.description)
    }
    assert in_map == set(KEPT)


def test_the_vendors_values_stand_where_the_map_says() -> None:
    face, access = _vendor()
    by_name = {"target_speed": 123_456, "ramp": 70_000, "target": -123_456_789, "trigger": 0}
    by_name |= {"origin_method": 21, "origin_speed": 4321, "origin_creep": 321, "origin_offset": -70_000}
    by_name |= {"gear_numerator": 3, "gear_denominator": 7, "torque_limit": 2500}
    by_name |= {"backlash": 5300, "backlash_quick": 1}
    access.write(by_name)
    access.write({"stiffness": 12.5})
    expected: dict[str, float] = {**by_name, "stiffness": 12.5}
    assert face.settings == expected
    assert access.read(list(expected)) == expected
    assert face.eeprom_writes == dict.fromkeys(
        (
            "origin_method",
            "origin_speed",
            "origin_creep",
            "origin_offset",
            "gear_numerator",
            "gear_denominator",
            "torque_limit",
            "stiffness",
        ),
        1,
    )


def test_the_vendors_order_is_taken_late_and_in_position_stands_until_then() -> None:
    face, access = _vendor()
    servo = face.servo
    assert isinstance(servo, SimulatedServo)
    access.write({"target": 600_000, "servo_on": 1, "trigger": 1})
    assert access.integers(["trigger", "in_position"]) == {"trigger": 1, "in_position": 1}
    face.tick(1_000_000)
    assert access.integers(["trigger", "in_position"]) == {"trigger": 1, "in_position": 1}
    face.tick(2_000_000)
    assert access.integers(["trigger", "in_position"]) == {"trigger": 0, "in_position": 0}


def test_the_vendors_drive_comes_back_to_life_when_its_enable_coil_was_left_set() -> None:
    face, access = _vendor()
    access.write({"servo_on": 1})
    face.servo.raise_fault(0x3210)
    access.write({"alarm_reset": 1})
    assert face.servo.powered  # what a client must not provoke: it takes the enable back first
    access.write({"alarm_reset": 0, "servo_on": 0})
    access.write({"servo_on": 1})
    face.servo.raise_fault(0x3210)
    map_ = load_drive_map("vendor_style")
    for write in map_.reset_fault[0].writes:
        access.command(write)
    assert not face.servo.powered
    assert face.servo.fault_code == 0


def test_half_a_value_and_gaps_are_refused() -> None:
    _, access = _vendor()
    with pytest.raises(AbortError) as caught:
        access.link.write(1, access.registers["target"].table, 0, (1,))
    assert caught.value.code == 2
    with pytest.raises(AbortError):
        access.neighbourhood("name_plate", 1)
    words = encode("X", Layout(RegisterType.STRING, length=6))
    with pytest.raises(AbortError):
        access.link.write(1, access.registers["name_plate"].table, 200, words)
