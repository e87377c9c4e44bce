"""The simulated drive's CiA-402 objects shown as blocks of holding registers.

The table maps addresses to objects; the objects themselves, the state machine and the hand-shakes are those of the
CANopen slave (`canopen_profile`), as in drives that have both protocols. Written without the client's register map; a test compares
them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from sim_backends.canopen_dictionary import (
    INVALID_VALUE,
    TOO_HIGH,
    TOO_LOW,
    WRONG_STATE,
    Dictionary,
    RefusedError,
    load_items,
)
from sim_backends.canopen_profile import DriveProfile
from sim_backends.modbus_registers import (
    DEVICE_FAILURE,
    ILLEGAL_ADDRESS,
    ILLEGAL_VALUE,
    Bank,
    Cell,
    RefusedRequestError,
    Space,
    Value,
)
from sim_backends.modbus_table import ERROR_MAP, BlockTable
from sim_backends.servo import SimulatedServo

EDS = Path(__file__).with_name("servo_drive.eds")
_SAVE = int.from_bytes(b"save", "little")
_MS = 1_000_000

# address, struct code of the register, object index, subindex
_OBJECTS: tuple[tuple[int, str, int, int], ...] = (
    (0x2000, "H", 0x6041, 0),
    (0x2001, "h", 0x6061, 0),
    (0x2002, "i", 0x6064, 0),
    (0x2004, "i", 0x606C, 0),
    (0x2006, "h", 0x6077, 0),
    (0x2007, "H", 0x603F, 0),
    (0x2008, "i", 0x60F4, 0),
    (0x200A, "i", 0x6062, 0),
    (0x200C, "I", 0x60FD, 0),
    (0x2100, "H", 0x6040, 0),
    (0x2101, "h", 0x6060, 0),
    (0x2102, "i", 0x607A, 0),
    (0x2104, "I", 0x6081, 0),
    (0x2106, "I", 0x6083, 0),
    (0x2108, "I", 0x6084, 0),
    (0x210A, "I", 0x6085, 0),
    (0x210C, "h", 0x605A, 0),
    (0x2200, "h", 0x6098, 0),
    (0x2202, "I", 0x6099, 1),
    (0x2204, "I", 0x6099, 2),
    (0x2206, "i", 0x607C, 0),
    (0x2300, "I", 0x608F, 1),
    (0x2302, "I", 0x608F, 2),
    (0x2304, "I", 0x6091, 1),
    (0x2306, "I", 0x6091, 2),
    (0x2308, "I", 0x6092, 1),
    (0x230A, "I", 0x6092, 2),
    (0x2400, "i", 0x607D, 1),
    (0x2402, "i", 0x607D, 2),
    (0x2404, "I", 0x6065, 0),
    (0x2406, "I", 0x6067, 0),
    (0x2408, "H", 0x6072, 0),
    (0x2500, "I", 0x1018, 1),
    (0x2502, "I", 0x1018, 2),
    (0x2504, "I", 0x1018, 4),
    (0x2600, "H", 0x60B8, 0),
    (0x2601, "H", 0x60B9, 0),
    *((0x2602 + 2 * place, "i", 0x60BA + place, 0) for place in range(4)),
    *((0x260A + 2 * place, "I", 0x60D1 + place, 0) for place in range(4)),
    *((0x2612 + place, "H", 0x60D5 + place, 0) for place in range(4)),
)
INPUTS, OUTPUTS = 32, 32
"""General inputs, as discrete inputs 0 to 31, and general outputs, as coils 0 to 31."""
_FIXED = (0x608F, 0x1018)  # read only over Modbus
KEPT = (0x607C, 0x6091, 0x6092, 0x607D, 0x6065, 0x6067, 0x6072)  # objects in EEPROM, written on every change


class Cia402Registers:
    """`Face` of a CiA-402 drive. parameters: {(index, subindex): value} over the EDS's defaults.

    eeprom_writes: number of writes per kept object; store_s: duration of saving all, s.
    """

    max_read = 125
    max_write = 123
    single_writes = True

    def __init__(self, servo: SimulatedServo, *, parameters: Mapping[tuple[int, int], int] | None = None) -> None:
        self.servo = servo
        self.dictionary = Dictionary(load_items(EDS, 1))
        for (index, subindex), value in (parameters or {}).items():
            self.dictionary.set_number(index, subindex, value)
        self.profile = DriveProfile(self.dictionary, servo, lambda _code: None)
        servo.backlash.follow(
            lambda: float(self.dictionary.number(0x2201)), lambda: bool(self.dictionary.number(0x2202))
        )
        self.eeprom_writes: dict[int, int] = {}
        self.stores = 0
        self.store_s = 0.2
        self._position_gain = 60.0
        self._now_ns = 0
        self._busy_until_ns = 0
        cells = [self._object_cell(*row) for row in _OBJECTS]
        cells += [
            Cell(0x240A, "f", lambda: self._position_gain, self._set_gain, 0.0, 1000.0),
            Cell(0x2410, "I", lambda: 0, self._store, write_only=True),
            Cell(0x2412, "H", lambda: int(self._now_ns < self._busy_until_ns)),
            Cell(0x2508, "16s", lambda: self.dictionary.raw((0x1008, 0))[:16]),
        ]
        self.table = BlockTable(ERROR_MAP, lambda: servo.powered, self._um_counts)
        servo.table.follow(self.table.own)
        cells += self.table.map_cells()
        inputs = [Cell(bit, "?", partial(self._input, bit)) for bit in range(INPUTS)]
        coils = [Cell(bit, "?", partial(self._output, bit), partial(self._switch, bit)) for bit in range(OUTPUTS)]
        self.banks: Mapping[Space, Bank] = {
            Space.HOLDING_REGISTERS: Bank(cells, gaps_readable=True),
            Space.DISCRETE_INPUTS: Bank(inputs, gaps_readable=False),
            Space.COILS: Bank(coils, gaps_readable=False),
        }

    def _input(self, bit: int) -> int:
        return self.profile.wires.inputs >> bit & 1

    def _output(self, bit: int) -> int:
        return self.profile.wires.outputs >> bit & 1

    def _switch(self, bit: int, level: Value) -> None:
        wires = self.profile.wires
        wires.outputs = wires.outputs & ~(1 << bit) | int(bool(level)) << bit

    def _um_counts(self) -> float:
        """Motor counts in a µm of travel, by 608Fh, 6091h and 6092h (whose feed is in µm)."""
        number = self.dictionary.number
        per_rev = number(0x608F, 1) / max(1, number(0x608F, 2)) * number(0x6091, 1) / max(1, number(0x6091, 2))
        return per_rev * max(1, number(0x6092, 2)) / max(1, number(0x6092, 1))

    def _object_cell(self, address: int, code: str, index: int, subindex: int) -> Cell:
        item = self.dictionary.item(index, subindex)
        writable = item.writable and index not in _FIXED
        return Cell(
            address,
            code,
            lambda: self.dictionary.number(index, subindex),
            self._writer(index, subindex) if writable else None,
        )

    def _writer(self, index: int, subindex: int) -> Callable[[Value], None]:
        codec = self.dictionary.item(index, subindex).codec
        if codec is None:
            raise ValueError(f"object {index:04X}h:{subindex} is not numeric")

        def write(value: Value) -> None:
            span = 8 * codec.size
            if not isinstance(value, int) or not -(1 << (span - 1)) <= value < 1 << span:
                raise RefusedRequestError(ILLEGAL_VALUE)
            try:
                self.dictionary.write(index, subindex, (value & ((1 << span) - 1)).to_bytes(codec.size, "little"))
            except RefusedError as refusal:
                raise RefusedRequestError(_exception_code(refusal.code)) from refusal
            if index in KEPT:
                self.eeprom_writes[index] = self.eeprom_writes.get(index, 0) + 1

        return write

    def _set_gain(self, value: Value) -> None:
        self._position_gain = float(value)
        self.eeprom_writes[0x240A] = self.eeprom_writes.get(0x240A, 0) + 1

    def _store(self, value: Value) -> None:
        if value != _SAVE:
            raise RefusedRequestError(ILLEGAL_VALUE)
        self.stores += 1
        self._busy_until_ns = self._now_ns + round(self.store_s * 1e9)

    # -- time ------------------------------------------------------------------------------------------------------------
    def tick(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self.profile.tick(now_ns)

    def bearable(self, now_ns: int) -> int:
        return 5 * _MS if self.servo.powered or now_ns < self._busy_until_ns else 1000 * _MS


def _exception_code(abort: int) -> int:
    if abort in (TOO_HIGH, TOO_LOW, INVALID_VALUE):
        return ILLEGAL_VALUE
    return DEVICE_FAILURE if abort == WRONG_STATE else ILLEGAL_ADDRESS
