"""Objects of communication (CiA 301), and inputs and outputs of an I/O module (CiA 401), by name."""

from __future__ import annotations

from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry

DEVICE_TYPE = Entry(0x1000, 0, DataType.U32, "device type")
ERROR_REGISTER = Entry(0x1001, 0, DataType.U8, "error register")
ERROR_HISTORY = Entry(0x1003, 0, DataType.U8, "number of errors")
SYNC_COB_ID = Entry(0x1005, 0, DataType.U32, "COB-ID SYNC")
SYNC_PERIOD = Entry(0x1006, 0, DataType.U32, "communication cycle period")
DEVICE_NAME = Entry(0x1008, 0, DataType.STRING, "manufacturer device name")
HARDWARE_VERSION = Entry(0x1009, 0, DataType.STRING, "hardware version")
SOFTWARE_VERSION = Entry(0x100A, 0, DataType.STRING, "software version")
GUARD_TIME = Entry(0x100C, 0, DataType.U16, "guard time")
LIFE_FACTOR = Entry(0x100D, 0, DataType.U8, "life time factor")
STORE_ALL = Entry(0x1010, 1, DataType.U32, "store all parameters")
RESTORE_ALL = Entry(0x1011, 1, DataType.U32, "restore all defaults")
EMCY_COB_ID = Entry(0x1014, 0, DataType.U32, "COB-ID EMCY")
CONSUMER_COUNT = Entry(0x1016, 0, DataType.U8, "number of consumer heartbeats")
CONSUMER_HEARTBEAT = Entry(0x1016, 1, DataType.U32, "consumer heartbeat time")
PRODUCER_HEARTBEAT = Entry(0x1017, 0, DataType.U16, "producer heartbeat time")
VENDOR_ID = Entry(0x1018, 1, DataType.U32, "vendor id")
PRODUCT_CODE = Entry(0x1018, 2, DataType.U32, "product code")
REVISION = Entry(0x1018, 3, DataType.U32, "revision number")
SERIAL_NUMBER = Entry(0x1018, 4, DataType.U32, "serial number")

NAMED = {entry.key: entry for entry in (*globals().values(), *vars(objects).values()) if isinstance(entry, Entry)}
"""These and those of CiA 402, by index and sub-index."""
SAVE = b"save"
ON_COMMAND = 0x01
"""Of 1010h:1 and 1011h:1 as read: it is done on command, by a write of `SAVE` or b"load"."""


def module_inputs(block: int) -> Entry:
    """Inputs 8 · block to 8 · block + 7 of an I/O module (CiA 401, 6000h)."""
    return Entry(0x6000, block + 1, DataType.U8, "digital inputs of a module")


def module_outputs(block: int) -> Entry:
    """Outputs 8 · block to 8 · block + 7 of an I/O module (CiA 401, 6200h)."""
    return Entry(0x6200, block + 1, DataType.U8, "digital outputs of a module")
