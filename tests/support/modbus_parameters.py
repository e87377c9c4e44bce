"""A Modbus drive with 40 parameters, its register map, and a line in simulated time with a fault at any chosen request."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from support.modbus_direct import DirectWire, pdu_of, values_of
from support.parameter_faults import KilledError

from drivers.errors import AbortError, NoAnswerError
from drivers.modbus.drive_map import DriveMap
from drivers.modbus.endpoint import Endpoint, RtuEndpoint
from drivers.modbus.link import LinkPolicy, ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.raw_parameters import ModbusLine, ModbusRawParameters
from drivers.modbus.wire import Request
from hil.parameters.set_file import ParameterSet, SetEntry
from sim_backends.clock import SimClock
from sim_backends.modbus_registers import Bank, Cell, Space, Value, answer

BAUD = 115_200
TYPES = (("u16", "H"), ("i16", "h"), ("u32", "I"), ("i32", "i"))
COUNT = 40
STORE = 250


def place(number: int) -> int:
    """Address of a parameter: groups of five neighbours of three registers at most, with gaps."""
    return 10 + 20 * (number // 5) + sum(2 if each % 4 >= 2 else 1 for each in range(5 * (number // 5), number))


_HEAD = """
[map]
name = "forty parameters"
description = "40 parameters, four inputs, a command to store"
address_base = "pdu0"
word_order = "big"
byte_order = "big"
gaps_readable = false
max_read_registers = 32
max_write_registers = 16

[registers.position]
address = 0
table = "input"
type = "i16"
unit = "counts"
"""
_DRIVE = """
[drive]
position = "position"
state = [
    { register = "alarm", value = 1, state = "fault" },
    { register = "is_on", value = 1, state = "operation enabled" },
    { register = "ready", value = 1, state = "switch on disabled" },
]
enable = [{ from = ["switch on disabled"], write = [{ register = "on", value = 1 }], to = ["operation enabled"] }]
disable = [{ from = ["operation enabled"], write = [{ register = "on", value = 0 }], to = ["switch on disabled"] }]
reset_fault = [{ from = ["fault"], write = [{ register = "on", value = 0 }], to = ["switch on disabled"] }]
quick_stop = { write = [{ register = "on", value = 0 }] }
halt = { write = [{ register = "on", value = 0 }] }
store = { write = [{ register = "store", value = 1 }] }

[drive.move]
handshake = "trigger"
target = "target"
velocity = "speed"
acceleration = "ramp"
idle = [{ register = "go", value = 0 }]
start = [{ register = "go", value = 1 }]
accepted = [{ register = "go", value = 0 }]
reached = [{ register = "arrived", value = 1 }]
"""


def write_map(folder: Path) -> Path:
    """The drive's register map as a file."""
    folder.mkdir(parents=True, exist_ok=True)
    parts = [_HEAD]
    for address, name in enumerate(("ready", "is_on", "alarm", "arrived")):
        parts.append(f'[registers.{name}]\naddress = {address}\ntable = "discrete"\n')
    parts.append('[registers.on]\naddress = 0\ntable = "coil"\n')
    for name, address, kind, unit in (
        ("target", 251, "i16", "counts"),
        ("speed", 252, "u16", "rpm"),
        ("ramp", 253, "u16", "rpm/s"),
        ("go", 254, "u16", ""),
    ):
        told = f'unit = "{unit}"\n' if unit else "self_clearing = true\n"
        parts.append(f'[registers.{name}]\naddress = {address}\ntable = "holding"\ntype = "{kind}"\n{told}')
    parts.append(f'[registers.store]\naddress = {STORE}\ntable = "holding"\ntype = "u16"\naccess = "wo"\n')
    for number in range(COUNT):
        parts.append(
            f'[registers.p{number}]\naddress = {place(number)}\ntable = "holding"\ntype = "{TYPES[number % 4][0]}"\n'
        )
    path = folder / "forty.toml"
    path.write_text("\n".join(parts) + _DRIVE, encoding="utf-8")
    return path


def forty(seed: int) -> ParameterSet:
    """Values for all 40 parameters."""
    values = [1 + (seed * 7919 + number * 104_729) % 30_000 for number in range(COUNT)]
    return ParameterSet(
        "forty", None, tuple(SetEntry(f"p{number}", value, value) for number, value in enumerate(values))
    )


OLD, NEW = forty(1), forty(2)


class FortyFace:
    """The drive: RAM and flash, and a command to store; `stores` counts its uses."""

    max_read, max_write, single_writes = 32, 16, True

    def __init__(self) -> None:
        self.ram = [int(entry.raw or 0) for entry in OLD.entries]
        self.flash = list(self.ram)
        self.stores = 0
        holding = [self._cell(number) for number in range(COUNT)]
        holding.append(Cell(STORE, "H", lambda: 0, self._store, write_only=True))
        inputs = [Cell(address, "?", lambda address=address: address == 0) for address in range(4)]
        self.banks: Mapping[Space, Bank] = {
            Space.DISCRETE_INPUTS: Bank(inputs, gaps_readable=False),
            Space.HOLDING_REGISTERS: Bank(holding, gaps_readable=False),
        }

    def _cell(self, number: int) -> Cell:
        def write(value: Value) -> None:
            self.ram[number] = int(value)

        return Cell(place(number), TYPES[number % 4][1], lambda: self.ram[number], write)

    def _store(self, _value: Value) -> None:
        self.flash = list(self.ram)
        self.stores += 1

    def reboot(self) -> None:
        self.ram = list(self.flash)

    def tick(self, now_ns: int) -> None: ...

    def bearable(self, now_ns: int) -> int:
        return 1_000_000_000


@dataclass
class Fault:
    """A fault at the n-th exchange (0: never); `for_s`: duration of the loss of a line or a supply, s."""

    kind: str = ""
    at: int = 0
    for_s: float = 0.0


class FaultyLine(DirectWire):
    """A serial line in simulated time: 11 bits a character, the drive's processing time, and one fault."""

    def __init__(self, face: FortyFace, clock: SimClock, fault: Fault, turnaround_s: float = 0.001) -> None:
        super().__init__(face)
        self.clock, self.fault, self.turnaround_s = clock, fault, turnaround_s
        self.exchanges = 0
        self.busy_s = 0.0
        self._gone_until_ns = 0

    def exchange(self, unit: int, request: Request, within_s: float = math.inf) -> tuple[int, ...]:
        self.exchanges += 1
        struck = self.fault.kind if self.exchanges == self.fault.at else ""
        if struck == "process killed":
            self.fault.at = self.exchanges + 1  # a killed process sends nothing more
            raise KilledError
        if struck in ("cable pulled", "power cut"):
            self._gone_until_ns = self.clock.now_ns() + round(1e9 * self.fault.for_s)
        if struck in ("node reboot", "power cut"):
            self.face.reboot()
        if self.clock.now_ns() < self._gone_until_ns or struck == "lost request":
            self._silence()
        if struck == "abort":
            raise AbortError("refused", 4)
        request_pdu = pdu_of(request)
        reply = answer(self.face, request_pdu)
        self._take(len(request_pdu), len(reply))
        if struck == "lost reply":
            self._silence()
        values = values_of(request, reply)
        return (values[0] ^ 1, *values[1:]) if struck == "wrong value read" and values else values

    def _silence(self) -> None:
        self.clock.sleep_s(0.05)
        raise NoAnswerError("no answer")

    def _take(self, request: int, reply: int) -> None:
        """The time of unit, PDU and check each way, 3.5 characters of silence before the reply (1.75 ms above 19200 baud)."""
        seconds = (request + reply + 6) * 11 / BAUD + 0.00175
        self.busy_s += seconds
        self.clock.sleep_s(seconds + self.turnaround_s)


@lru_cache
def _loaded(path: Path, _changed_ns: int) -> DriveMap:
    return load_drive_map(path)


def connect(map_path: Path, line: FaultyLine) -> ModbusRawParameters:
    """The drive's parameters over such a line."""
    make: Callable[[Endpoint], FaultyLine] = lambda _endpoint: line  # noqa: E731
    link = ModbusLink(RtuEndpoint("nowhere", BAUD), line.clock, policy=LinkPolicy(), make_wire=make)
    link.open()
    return ModbusRawParameters("Z", ModbusLine(link), 7, _loaded(map_path, map_path.stat().st_mtime_ns))
