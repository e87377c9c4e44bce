"""The objects of CiA-301 and CiA-402 that this project reads and writes, with names and types.

Index, subindex, type and name of standard objects, and how a value of such a type is packed. Manufacturer objects come from an EDS
(see `eds`).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum

from drivers.canopen.sdo_transfer import LARGEST_ANNOUNCED
from drivers.errors import InputError, ProtocolError

LONGEST_TEXT = 4096
"""Longest VISIBLE_STRING that is read, bytes; the standard's texts have a few dozen."""


class DataType(Enum):
    """Basic data types of CiA-301 by their code in 0002h… of the dictionary: (code, struct format or "" for bytes)."""

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
    DOMAIN = (0x0F, "")
    F64 = (0x11, "<d")
    I64 = (0x15, "<q")
    U64 = (0x1B, "<Q")

    def __init__(self, code: int, struct_format: str) -> None:
        self.code = code
        self.format = struct_format
        self.size = struct.calcsize(struct_format) if struct_format else 0

    @property
    def is_number(self) -> bool:
        """Whether values are numbers (BOOLEAN included), not texts or bytes."""
        return bool(self.format)

    @property
    def is_signed(self) -> bool:
        """Whether values are signed integers."""
        return self.format in ("<b", "<h", "<i", "<q")


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
    def bits(self) -> int:
        """Length in bits, 0 for texts and bytes."""
        return 8 * self.type.size

    @property
    def mapping(self) -> int:
        """The value that maps this entry into a PDO: index, subindex, length in bits."""
        return self.index << 16 | self.subindex << 8 | self.bits

    @property
    def most_bytes(self) -> int:
        """Longest answer accepted, bytes: for a number eight, the longest type's, as some devices answer with more than the object
        has."""
        return 8 if self.type.is_number else LONGEST_TEXT if self.type is DataType.STRING else LARGEST_ANNOUNCED

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
        return shown == meant

    def pack(self, value: float | bool | bytes | str) -> bytes:
        """Value -> bytes on the wire. Raises InputError when it does not fit the type."""
        if not self.type.is_number:
            return value.encode("latin-1") if isinstance(value, str) else bytes(value)  # type: ignore[arg-type]
        try:
            return struct.pack(self.type.format, value)
        except struct.error as error:
            raise InputError(f"{self}: {value!r} does not fit {self.type.name}") from error

    def unpack(self, data: bytes) -> float | bool | bytes | str:
        """Bytes on the wire -> value. Raises ProtocolError on a wrong length (longer than needed is cut, see below).

        Some devices answer four bytes for a narrower object; the surplus is ignored, as CiA-301's expedited answers without a
        size allow.
        """
        if self.type is DataType.STRING:
            return data.rstrip(b"\0").decode("latin-1")
        if not self.type.is_number:
            return bytes(data)
        if len(data) < self.type.size:
            raise ProtocolError(f"{self}: answered {len(data)} bytes, {self.type.name} needs {self.type.size}")
        value: float | bool = struct.unpack_from(self.type.format, data)[0]
        return value


def _entry(index: int, subindex: int, data_type: DataType, name: str) -> Entry:
    return Entry(index, subindex, data_type, name)


# CiA-301, communication
DEVICE_TYPE = _entry(0x1000, 0, DataType.U32, "device type")
ERROR_REGISTER = _entry(0x1001, 0, DataType.U8, "error register")
ERROR_HISTORY = _entry(0x1003, 0, DataType.U8, "number of errors")
SYNC_COB_ID = _entry(0x1005, 0, DataType.U32, "COB-ID SYNC")
SYNC_PERIOD = _entry(0x1006, 0, DataType.U32, "communication cycle period")
DEVICE_NAME = _entry(0x1008, 0, DataType.STRING, "manufacturer device name")
HARDWARE_VERSION = _entry(0x1009, 0, DataType.STRING, "hardware version")
SOFTWARE_VERSION = _entry(0x100A, 0, DataType.STRING, "software version")
STORE_ALL = _entry(0x1010, 1, DataType.U32, "store all parameters")
RESTORE_ALL = _entry(0x1011, 1, DataType.U32, "restore all defaults")
EMCY_COB_ID = _entry(0x1014, 0, DataType.U32, "COB-ID EMCY")
CONSUMER_HEARTBEAT = _entry(0x1016, 1, DataType.U32, "consumer heartbeat time")
PRODUCER_HEARTBEAT = _entry(0x1017, 0, DataType.U16, "producer heartbeat time")
VENDOR_ID = _entry(0x1018, 1, DataType.U32, "vendor id")
PRODUCT_CODE = _entry(0x1018, 2, DataType.U32, "product code")
REVISION = _entry(0x1018, 3, DataType.U32, "revision number")
SERIAL_NUMBER = _entry(0x1018, 4, DataType.U32, "serial number")

# CiA-402, device control
ABORT_OPTION = _entry(0x6007, 0, DataType.I16, "abort connection option code")
ERROR_CODE = _entry(0x603F, 0, DataType.U16, "error code")
CONTROLWORD = _entry(0x6040, 0, DataType.U16, "controlword")
STATUSWORD = _entry(0x6041, 0, DataType.U16, "statusword")
QUICK_STOP_OPTION = _entry(0x605A, 0, DataType.I16, "quick stop option code")
SHUTDOWN_OPTION = _entry(0x605B, 0, DataType.I16, "shutdown option code")
DISABLE_OPTION = _entry(0x605C, 0, DataType.I16, "disable operation option code")
HALT_OPTION = _entry(0x605D, 0, DataType.I16, "halt option code")
FAULT_REACTION_OPTION = _entry(0x605E, 0, DataType.I16, "fault reaction option code")
MODE = _entry(0x6060, 0, DataType.I8, "modes of operation")
MODE_DISPLAY = _entry(0x6061, 0, DataType.I8, "modes of operation display")
SUPPORTED_MODES = _entry(0x6502, 0, DataType.U32, "supported drive modes")

# CiA-402, values
POSITION_DEMAND = _entry(0x6062, 0, DataType.I32, "position demand value")
POSITION_ACTUAL = _entry(0x6064, 0, DataType.I32, "position actual value")
FOLLOWING_ERROR_WINDOW = _entry(0x6065, 0, DataType.U32, "following error window")
FOLLOWING_ERROR_TIMEOUT = _entry(0x6066, 0, DataType.U16, "following error time out")
POSITION_WINDOW = _entry(0x6067, 0, DataType.U32, "position window")
POSITION_WINDOW_TIME = _entry(0x6068, 0, DataType.U16, "position window time")
VELOCITY_ACTUAL = _entry(0x606C, 0, DataType.I32, "velocity actual value")
TARGET_TORQUE = _entry(0x6071, 0, DataType.I16, "target torque")
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
TARGET_VELOCITY = _entry(0x60FF, 0, DataType.I32, "target velocity")
