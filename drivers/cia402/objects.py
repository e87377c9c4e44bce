"""Objects of a drive: index, sub-index, type and name, how a value of such a type is packed, and those of CiA 402 by name."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum

from drivers.errors import InputError, ProtocolError


class DataType(Enum):
    """Data types of CiA-301 (table 44) by their code in the dictionary: (code, struct format or "", bytes where there is no format).

    Texts and bytes have size 0 where their length is free. TIME_OF_DAY and TIME_DIFFERENCE are taken as their six bytes.
    """

    BOOLEAN = (0x01, "<?")
    I8 = (0x02, "<b")
    I16 = (0x03, "<h")
    I32 = (0x04, "<i")
    U8 = (0x05, "<B")
    U16 = (0x06, "<H")
    U32 = (0x07, "<I")
    F32 = (0x08, "<f")
    STRING = (0x09, "")
    OCTETS = (0x0A, "")
    UNICODE = (0x0B, "")
    TIME_OF_DAY = (0x0C, "", 6)
    TIME_DIFFERENCE = (0x0D, "", 6)
    DOMAIN = (0x0F, "")
    I24 = (0x10, "", 3)
    F64 = (0x11, "<d")
    I40 = (0x12, "", 5)
    I48 = (0x13, "", 6)
    I56 = (0x14, "", 7)
    I64 = (0x15, "<q")
    U24 = (0x16, "", 3)
    U40 = (0x18, "", 5)
    U48 = (0x19, "", 6)
    U56 = (0x1A, "", 7)
    U64 = (0x1B, "<Q")

    def __init__(self, code: int, struct_format: str, size: int = 0) -> None:
        self.code = code
        self.format = struct_format
        self.size = struct.calcsize(struct_format) if struct_format else size

    @property
    def is_number(self) -> bool:
        """Whether values are numbers (BOOLEAN included), not texts or bytes."""
        return bool(self.format) or self.is_odd

    @property
    def is_odd(self) -> bool:
        """Whether values are integers of 24, 40, 48 or 56 bit, for which `struct` has no format."""
        return not self.format and self.name[1:].isdigit()

    @property
    def is_real(self) -> bool:
        """Whether values are floating-point numbers."""
        return self in (DataType.F32, DataType.F64)

    @property
    def is_signed(self) -> bool:
        """Whether values are signed integers."""
        return self.is_number and self.name[0] == "I"

    @property
    def is_text(self) -> bool:
        """Whether values are texts: VISIBLE_STRING, or UNICODE_STRING (16-bit units)."""
        return self in (DataType.STRING, DataType.UNICODE)

    @property
    def range(self) -> tuple[int, int]:
        """Lowest and highest value of an integer type; BOOLEAN has 0 and 1."""
        bits = 1 if self is DataType.BOOLEAN else 8 * self.size
        return (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if self.is_signed else (0, (1 << bits) - 1)


@dataclass(frozen=True)
class Entry:
    """One object dictionary entry."""

    index: int
    subindex: int
    type: DataType
    name: str

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.subindex:02X} {self.name}"

    @property
    def key(self) -> tuple[int, int]:
        """Index and sub-index."""
        return self.index, self.subindex

    @property
    def bits(self) -> int:
        """Length in bits, 0 for texts and bytes."""
        return 8 * self.type.size

    @property
    def mapping(self) -> int:
        """The value that maps this entry into a PDO: index, subindex, length in bits."""
        return self.index << 16 | self.subindex << 8 | self.bits

    def same(self, shown: bytes, meant: bytes) -> bool:
        """Whether `shown`, read from a device, equals `meant`, by the type.

        A number: its own bytes are equal; bytes behind them are ignored. A text: devices whose texts have a fixed length fill them
        with zeros or spaces, so these are ignored behind it, as are zeros behind `meant`; anything else counts. Other bytes: equal
        and of equal length.
        """
        if self.type.is_number:
            return len(meant) == self.type.size and shown[: len(meant)] == meant
        if self.type is DataType.STRING:
            text = meant.rstrip(b"\0")
            return shown.startswith(text) and not shown[len(text) :].strip(b"\0 ")
        if self.type is DataType.UNICODE and len(shown) % 2 == 0 == len(meant) % 2:
            held, wanted = (str(self.unpack(data)) for data in (shown, meant))
            return held.startswith(wanted) and not held[len(wanted) :].strip("\0 ")
        return shown == meant

    def pack(self, value: float | bool | bytes | str) -> bytes:
        """Value -> bytes on the wire. Raises InputError when it does not fit the type."""
        if not self.type.is_number:
            return self._pack_bytes(value)
        if self.type.is_odd:
            low, high = self.type.range
            if not isinstance(value, int) or not low <= value <= high:
                raise InputError(f"{self}: {value!r} does not fit {self.type.name}")
            return value.to_bytes(self.type.size, "little", signed=self.type.is_signed)
        try:
            return struct.pack(self.type.format, value)
        except (struct.error, OverflowError) as error:
            raise InputError(f"{self}: {value!r} does not fit {self.type.name}") from error

    def _pack_bytes(self, value: object) -> bytes:
        """A text or bytes as they go on the wire; a number is neither. Raises InputError."""
        if isinstance(value, str):
            try:
                return value.encode("utf-16-le" if self.type is DataType.UNICODE else "latin-1")
            except UnicodeEncodeError as error:
                raise InputError(f"{self}: {value!r} does not fit {self.type.name}") from error
        if not isinstance(value, bytes | bytearray) or (self.type.size and len(value) != self.type.size):
            raise InputError(f"{self}: {value!r} does not fit {self.type.name}")
        return bytes(value)

    def unpack(self, data: bytes) -> float | bool | bytes | str:
        """Bytes on the wire -> value. Raises ProtocolError on a wrong length (longer than needed is cut, see below).

        Some devices answer four bytes for a narrower object; the surplus is ignored, as CiA-301's expedited answers without a
        size allow.
        """
        if self.type is DataType.STRING:
            return data.rstrip(b"\0").decode("latin-1")
        if self.type is DataType.UNICODE:
            return data.decode("utf-16-le", errors="replace").rstrip("\0")
        if not self.type.is_number:
            return bytes(data)
        if len(data) < self.type.size:
            raise ProtocolError(f"{self}: answered {len(data)} bytes, {self.type.name} needs {self.type.size}")
        if self.type.is_odd:
            return int.from_bytes(data[: self.type.size], "little", signed=self.type.is_signed)
        value: float | bool = struct.unpack_from(self.type.format, data)[0]
        return value


def _entry(index: int, subindex: int, data_type: DataType, name: str) -> Entry:
    return Entry(index, subindex, data_type, name)


# device control
ABORT_OPTION = _entry(0x6007, 0, DataType.I16, "abort connection option code")
ERROR_CODE = _entry(0x603F, 0, DataType.U16, "error code")
CONTROLWORD = _entry(0x6040, 0, DataType.U16, "controlword")
STATUSWORD = _entry(0x6041, 0, DataType.U16, "statusword")
QUICK_STOP_OPTION = _entry(0x605A, 0, DataType.I16, "quick stop option code")
SHUTDOWN_OPTION = _entry(0x605B, 0, DataType.I16, "shutdown option code")
DISABLE_OPTION = _entry(0x605C, 0, DataType.I16, "disable operation option code")
HALT_OPTION = _entry(0x605D, 0, DataType.I16, "halt option code")
FAULT_REACTION_OPTION = _entry(0x605E, 0, DataType.I16, "fault reaction option code")
INTERPOLATION_TARGET = _entry(0x60C1, 1, DataType.I32, "interpolation data record, first value")
BUFFER_CLEAR = _entry(0x60C4, 6, DataType.U8, "interpolation buffer clear")
MAX_PROFILE_VELOCITY = _entry(0x607F, 0, DataType.U32, "max profile velocity")
MAX_ACCELERATION = _entry(0x60C5, 0, DataType.U32, "max acceleration")
MAX_DECELERATION = _entry(0x60C6, 0, DataType.U32, "max deceleration")
VELOCITY_NOTATION = _entry(0x608B, 0, DataType.I8, "velocity notation index")
VELOCITY_DIMENSION = _entry(0x608C, 0, DataType.U8, "velocity dimension index")
ACCELERATION_NOTATION = _entry(0x608D, 0, DataType.I8, "acceleration notation index")
ACCELERATION_DIMENSION = _entry(0x608E, 0, DataType.U8, "acceleration dimension index")
VELOCITY_ENCODER_INCREMENTS = _entry(0x6090, 1, DataType.U32, "velocity encoder increments per s")
VELOCITY_ENCODER_REVOLUTIONS = _entry(0x6090, 2, DataType.U32, "velocity encoder revolutions per s")
VELOCITY_FACTOR = tuple(_entry(0x6094, n, DataType.U32, "velocity encoder factor") for n in (1, 2))
VELOCITY_FACTOR_NEW = tuple(_entry(0x6096, n, DataType.U32, "velocity factor") for n in (1, 2))
ACCELERATION_FACTOR = tuple(_entry(0x6097, n, DataType.U32, "acceleration factor") for n in (1, 2))
SI_UNIT_VELOCITY = _entry(0x60A9, 0, DataType.U32, "SI unit velocity")
SI_UNIT_ACCELERATION = _entry(0x60AA, 0, DataType.U32, "SI unit acceleration")
MODE = _entry(0x6060, 0, DataType.I8, "modes of operation")
MODE_DISPLAY = _entry(0x6061, 0, DataType.I8, "modes of operation display")
SUPPORTED_MODES = _entry(0x6502, 0, DataType.U32, "supported drive modes")

# values
POSITION_DEMAND = _entry(0x6062, 0, DataType.I32, "position demand value")
POSITION_ACTUAL = _entry(0x6064, 0, DataType.I32, "position actual value")
FOLLOWING_ERROR_WINDOW = _entry(0x6065, 0, DataType.U32, "following error window")
FOLLOWING_ERROR_TIMEOUT = _entry(0x6066, 0, DataType.U16, "following error time out")
POSITION_WINDOW = _entry(0x6067, 0, DataType.U32, "position window")
POSITION_WINDOW_TIME = _entry(0x6068, 0, DataType.U16, "position window time")
VELOCITY_ACTUAL = _entry(0x606C, 0, DataType.I32, "velocity actual value")
TARGET_TORQUE = _entry(0x6071, 0, DataType.I16, "target torque")
MAX_TORQUE = _entry(0x6072, 0, DataType.U16, "max torque")
TORQUE_ACTUAL = _entry(0x6077, 0, DataType.I16, "torque actual value")
TARGET_POSITION = _entry(0x607A, 0, DataType.I32, "target position")
HOME_OFFSET = _entry(0x607C, 0, DataType.I32, "home offset")
SOFTWARE_LIMIT_MIN = _entry(0x607D, 1, DataType.I32, "software position limit min")
SOFTWARE_LIMIT_MAX = _entry(0x607D, 2, DataType.I32, "software position limit max")
PROFILE_VELOCITY = _entry(0x6081, 0, DataType.U32, "profile velocity")
PROFILE_ACCELERATION = _entry(0x6083, 0, DataType.U32, "profile acceleration")
PROFILE_DECELERATION = _entry(0x6084, 0, DataType.U32, "profile deceleration")
QUICK_STOP_DECELERATION = _entry(0x6085, 0, DataType.U32, "quick stop deceleration")
ENCODER_INCREMENTS = _entry(0x608F, 1, DataType.U32, "encoder increments")
ENCODER_REVOLUTIONS = _entry(0x608F, 2, DataType.U32, "motor revolutions")
GEAR_MOTOR_REVOLUTIONS = _entry(0x6091, 1, DataType.U32, "gear motor revolutions")
GEAR_SHAFT_REVOLUTIONS = _entry(0x6091, 2, DataType.U32, "gear shaft revolutions")
FEED = _entry(0x6092, 1, DataType.U32, "feed")
FEED_SHAFT_REVOLUTIONS = _entry(0x6092, 2, DataType.U32, "feed shaft revolutions")
HOMING_METHOD = _entry(0x6098, 0, DataType.I8, "homing method")
HOMING_SPEED_SWITCH = _entry(0x6099, 1, DataType.U32, "homing speed during search for switch")
HOMING_SPEED_ZERO = _entry(0x6099, 2, DataType.U32, "homing speed during search for zero")
HOMING_ACCELERATION = _entry(0x609A, 0, DataType.U32, "homing acceleration")
SI_UNIT_POSITION = _entry(0x60A8, 0, DataType.U32, "SI unit position")
POSITION_OFFSET = _entry(0x60B0, 0, DataType.I32, "position offset")
PROBE_FUNCTION = _entry(0x60B8, 0, DataType.U16, "touch probe function")
PROBE_STATUS = _entry(0x60B9, 0, DataType.U16, "touch probe status")
_EDGES = ((0, "positive"), (1, "negative"), (2, "positive"), (3, "negative"))  # of probe 1, then of probe 2
PROBE_POSITION = tuple(_entry(0x60BA + n, 0, DataType.I32, f"touch probe {n // 2 + 1} {e} edge") for n, e in _EDGES)
PROBE_STAMP = tuple(_entry(0x60D1 + n, 0, DataType.U32, f"touch probe time stamp {n // 2 + 1} {e}") for n, e in _EDGES)
PROBE_COUNTER = tuple(
    _entry(0x60D5 + n, 0, DataType.U16, f"touch probe {n // 2 + 1} {e} edge counter") for n, e in _EDGES
)
INTERPOLATION_PERIOD = _entry(0x60C2, 1, DataType.U8, "interpolation time period value")
INTERPOLATION_EXPONENT = _entry(0x60C2, 2, DataType.I8, "interpolation time index")
FOLLOWING_ERROR_ACTUAL = _entry(0x60F4, 0, DataType.I32, "following error actual value")
DIGITAL_INPUTS = _entry(0x60FD, 0, DataType.U32, "digital inputs")
DIGITAL_OUTPUTS = _entry(0x60FE, 1, DataType.U32, "physical outputs")
DIGITAL_OUTPUTS_MASK = _entry(0x60FE, 2, DataType.U32, "mask of the outputs")
TARGET_VELOCITY = _entry(0x60FF, 0, DataType.I32, "target velocity")
