"""An independent reading of EDS and DCF files by regular expressions, as CiA 306 has the values. Imports nothing of the project.

Of each entry: default, configured value and limits. Of a key that stands twice the first counts, which leaves it to the reader under
test to note that it took another.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

Value = int | float | str | bytes | None
FIELDS = {"default": "defaultvalue", "value": "parametervalue", "low": "lowlimit", "high": "highlimit"}

# CiA 301, table 44: code -> width in bits
SIGNED = {0x02: 8, 0x03: 16, 0x04: 32, 0x10: 24, 0x12: 40, 0x13: 48, 0x14: 56, 0x15: 64}
UNSIGNED = {0x01: 1, 0x05: 8, 0x06: 16, 0x07: 32, 0x16: 24, 0x18: 40, 0x19: 48, 0x1A: 56, 0x1B: 64}
REAL = {0x08: (">f", 32), 0x11: (">d", 64)}
VISIBLE, OCTETS, UNICODE, DOMAIN = 0x09, 0x0A, 0x0B, 0x0F
NUMBERS = SIGNED | UNSIGNED | dict.fromkeys(REAL)
NAMES = (
    {"BOOLEAN": 1}
    | {f"INTEGER{b}": c for c, b in SIGNED.items()}
    | {f"UNSIGNED{b}": c for c, b in UNSIGNED.items() if b > 1}
)

SECTION = re.compile(r"(?m)^[ \t]*\[[ \t]*([^\]\r\n]*?)[ \t]*\][^\n]*$")
PAIR = re.compile(r"(?m)^[ \t]*([A-Za-z0-9_]+)[ \t]*=[ \t]*([^\r\n]*?)[ \t]*\r?$")
OBJECT = re.compile(r"(?i)^([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?$")
INTEGER = re.compile(r"(?i)^(-?)(?:0x([0-9a-f]+)|([0-9]+))(?:u?l{0,2})$")
NODE = re.compile(r"(?i)^(?:\$nodeid(?:\s*\+\s*(0x[0-9a-f]+|[0-9]+))?|(0x[0-9a-f]+|[0-9]+)\s*\+\s*\$nodeid)$")
WRONG = object()
"""A value that CiA 306 does not know for its type."""


@dataclass
class Reading:
    """entries: key -> field -> value, `WRONG` where the text is no value of the type; sections: key -> name in the file."""

    entries: dict[tuple[int, int], dict[str, object]] = field(default_factory=dict)
    texts: dict[tuple[int, int], dict[str, str]] = field(default_factory=dict)


def read(path: Path, node_id: int) -> Reading:
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    sections: dict[str, dict[str, str]] = {}
    heads = list(SECTION.finditer(text))
    for head, after in zip(heads, [*heads, None][1:], strict=True):
        body = text[head.end() : after.start() if after else len(text)]
        keys = sections.setdefault(head[1].replace(" ", "").lower(), {})
        for key, value in PAIR.findall(body):
            keys.setdefault(key.lower(), value)
    reading = Reading()
    for name, keys in sections.items():
        match = OBJECT.match(name)
        if match is None:
            continue
        index = int(match[1], 16)
        if match[2] is None:
            count = _integer(keys.get("compactsubobj", "0").split(";")[0].strip())
            if isinstance(count, int) and count:
                for subindex, member in _compact(count, keys, sections.get(f"{name}value", {})):
                    _take(reading, (index, subindex), member, node_id)
                continue
            if any(re.match(rf"{name}sub[0-9a-f]", other) for other in sections):
                continue
            if _integer(keys.get("objecttype", "7").split(";")[0].strip()) in (8, 9):
                continue
        _take(reading, (index, int(match[2] or "0", 16)), keys, node_id)
    return reading


def _compact(count: int, keys: dict[str, str], values: dict[str, str]) -> Iterator[tuple[int, dict[str, str]]]:
    """CompactSubObj: members like the array; the values of [iiiiValue] are configured values."""
    for subindex in range(1, count + 1):
        member = dict(keys)
        if str(subindex) in values:
            member["parametervalue"] = values[str(subindex)]
        yield subindex, member


def _take(reading: Reading, key: tuple[int, int], keys: dict[str, str], node_id: int) -> None:
    kind = keys.get("datatype", "").split(";")[0].strip()
    code = NAMES.get(kind.upper()) or _integer(kind)
    found: dict[str, object] = {}
    for name, written in FIELDS.items():
        text = keys.get(written, "")
        if code not in (VISIBLE, UNICODE):
            text = text.split(";")[0].strip()
        if name in ("low", "high") and code not in NUMBERS:
            continue
        is_text = code in (VISIBLE, UNICODE) and written in keys
        found[name] = _value(text, code, node_id, limit=name in ("low", "high")) if text or is_text else None
    reading.entries[key] = found
    reading.texts[key] = {name: keys.get(written, "") for name, written in FIELDS.items()}


def _integer(text: str) -> int | None:
    match = INTEGER.match(text)
    if match is None:
        return None
    if match[2]:
        number = int(match[2], 16)
    else:
        octal = len(match[3]) > 1 and match[3][0] == "0"
        if octal and re.search("[89]", match[3]):
            return None
        number = int(match[3], 8 if octal else 10)
    return -number if match[1] else number


def _value(text: str, code: object, node_id: int, *, limit: bool) -> object:
    if code in (VISIBLE, UNICODE):
        return text
    if code in (OCTETS, DOMAIN):
        return bytes.fromhex(text) if re.fullmatch(r"(?i)(?:[0-9a-f]{2})+", text) else WRONG
    if code in REAL:
        return _real(text, *REAL[code])
    relative = NODE.match(text)
    if relative and code in NUMBERS:
        return node_id + (_integer(relative[1] or relative[2] or "0") or 0)
    number = _integer(text)
    if number is None or code not in NUMBERS:
        return WRONG
    if code in SIGNED:
        bits = SIGNED[code]
        if "x" in text.lower() and not text.startswith("-") and number >> (bits - 1) == 1:
            number -= 1 << bits
        fits = -(1 << (bits - 1)) <= number < 1 << (bits - 1)
    else:
        fits = 0 <= number < 1 << UNSIGNED[code]
    return number if fits or limit else WRONG


def _real(text: str, form: str, bits: int) -> object:
    if re.fullmatch(r"(?i)0x[0-9a-f]+", text):
        return struct.unpack(form, int(text, 16).to_bytes(bits // 8, "big"))[0] if int(text, 16) < 1 << bits else WRONG
    return float(text) if re.fullmatch(r"(?i)[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", text) else WRONG
