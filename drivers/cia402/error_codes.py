"""Error codes of 603Fh and of emergencies, in words."""

from __future__ import annotations

ERROR_CLASSES: tuple[tuple[int, int, str], ...] = (
    # mask, value, text; the first that matches (CiA-301 table 26, CiA-402 error codes)
    (0xFFFF, 0x0000, "no error"),
    (0xFFFF, 0x2310, "continuous over current"),
    (0xFFFF, 0x2320, "short circuit or earth leakage"),
    (0xFFFF, 0x3210, "DC link over-voltage"),
    (0xFFFF, 0x3220, "DC link under-voltage"),
    (0xFFFF, 0x4210, "device over-temperature"),
    (0xFFFF, 0x4310, "drive over-temperature"),
    (0xFFFF, 0x7121, "motor blocked"),
    (0xFFFF, 0x7305, "incremental sensor 1 fault"),
    (0xFFFF, 0x8120, "CAN in error passive mode"),
    (0xFFFF, 0x8130, "life guard or heartbeat error"),
    (0xFFFF, 0x8140, "recovered from bus off"),
    (0xFFFF, 0x8210, "PDO not processed, length error"),
    (0xFFFF, 0x8220, "PDO length exceeded"),
    (0xFFFF, 0x8400, "velocity speed control"),
    (0xFFFF, 0x8500, "position control"),
    (0xFFFF, 0x8611, "following error"),
    (0xFFFF, 0x8612, "reference limit"),
    (0xFF00, 0x1000, "generic error"),
    (0xF000, 0x2000, "current"),
    (0xF000, 0x3000, "voltage"),
    (0xF000, 0x4000, "temperature"),
    (0xFF00, 0x5000, "device hardware"),
    (0xF000, 0x6000, "device software"),
    (0xF000, 0x7000, "additional modules"),
    (0xFF00, 0x8100, "communication"),
    (0xFF00, 0x8200, "protocol"),
    (0xFF00, 0x8600, "positioning"),
    (0xFF00, 0x9000, "external error"),
    (0xFF00, 0xF000, "additional functions"),
    (0xFF00, 0xFF00, "device specific"),
)


def error_text(code: int) -> str:
    """Meaning and number of an error code of EMCY or 603Fh (CiA-301, CiA-402)."""
    for mask, value, text in ERROR_CLASSES:
        if code & mask == value:
            return f"{text} ({code:04X}h)"
    return f"unknown error ({code:04X}h)"
