"""A maker's EDS or DCF file as the simulated strict drive takes it: objects with their rights and limits, and its units of motion.

Read by regular expressions, apart from the reader that the bridge uses (`drivers.canopen.eds`), so that a fault in the one is seen
by the other. A text that cannot be read as a number leaves the object without a default; the drive then holds 0.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError
from sim_backends.canopen_dictionary import Item, Key

LAYOUTS = {0x01: "<?", 0x02: "<b", 0x03: "<h", 0x04: "<i", 0x05: "<B", 0x06: "<H", 0x07: "<I", 0x15: "<q", 0x1B: "<Q"}
BY_NAME = {
    "BOOLEAN": 0x01,
    "INTEGER8": 0x02,
    "INTEGER16": 0x03,
    "INTEGER32": 0x04,
    "UNSIGNED8": 0x05,
    "UNSIGNED16": 0x06,
    "UNSIGNED32": 0x07,
    "INTEGER64": 0x15,
    "UNSIGNED64": 0x1B,
}
REAL32 = 0x08
_TERM = re.compile(r"(\$NODEID|[+-]?0x[0-9a-f]+|[+-]?\d+)", re.IGNORECASE)
_SECTION = re.compile(r"^\[\s*(.+?)\s*\]")
_OBJECT = re.compile(r"^([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?$")
PROFILE = 0x00020192  # 1000h of a servo drive: device profile 402


@dataclass(frozen=True)
class MakerFile:
    """path: for messages. texts: the file's objects as written, {key: {entry in lower case: text}}."""

    path: Path
    texts: Mapping[Key, Mapping[str, str]]
    device: Mapping[str, str]

    def number(self, index: int, subindex: int = 0, node_id: int = 1) -> int | None:
        """The value as delivered: a DCF's ParameterValue is the value of one user, so only DefaultValue counts."""
        entry = self.texts.get((index, subindex))
        return None if entry is None else number_in(entry.get("defaultvalue", ""), node_id)

    @property
    def vendor(self) -> int:
        """1018h:1, else the number of [DeviceInfo]; 0 where neither says it."""
        return self.number(0x1018, 1) or number_in(self.device.get("vendornumber", "")) or 0

    @property
    def product(self) -> str:
        return self.device.get("productname", "")

    @property
    def axes(self) -> int:
        """Number of axes in the node, by the controlwords 6040h + n·800h."""
        return next(number for number in range(8) if (0x6040 + 0x800 * number, 0) not in self.texts)

    def items(self, node_id: int) -> dict[Key, Item]:
        """The objects as entries of the simulated dictionary, without values that the file does not state."""
        return {key: self._item(key, entry, node_id) for key, entry in self.texts.items()}

    def _item(self, key: Key, entry: Mapping[str, str], node_id: int) -> Item:
        type_text = entry.get("datatype", "")
        code = BY_NAME.get(type_text.upper()) or number_in(type_text) or 0
        layout = LAYOUTS.get(code)
        access = entry.get("accesstype", "rw").lower()
        mappable = number_in(entry.get("pdomapping", "")) == 1
        text = entry.get("defaultvalue", "")
        if layout is None:
            raw = bytes(4) if code == REAL32 else text.encode("latin-1", "replace")
            return Item(*key, entry.get("parametername", ""), access, None, None, None, mappable, raw)
        codec = struct.Struct(layout)
        bits, signed = 8 * codec.size, layout[1].islower()
        value = _in_type(number_in(text, node_id) or 0, bits, signed)
        low, high = (_limit(entry.get(name, ""), node_id, bits, signed) for name in ("lowlimit", "highlimit"))
        if low is not None and high is not None and low > high:
            low = high = None
        return Item(*key, entry.get("parametername", ""), access, codec, low, high, mappable, codec.pack(value))


def number_in(text: str, node_id: int = 1) -> int | None:
    """A number of an EDS: decimal, hexadecimal, and sums with $NODEID; None where there is none. A comment behind it is ignored."""
    text = text.partition(";")[0]
    terms = [term.lstrip("+").lower() for term in _TERM.findall(text.replace(" ", ""))]
    if not terms:
        return None
    return sum(node_id if term == "$nodeid" else int(term, 16 if "0x" in term else 10) for term in terms)


def _in_type(value: int, bits: int, signed: bool) -> int:
    if bits == 8 * struct.calcsize("<?") and value in (0, 1):
        return value
    value &= (1 << bits) - 1
    return value - (1 << bits) if signed and value >> (bits - 1) else value


def _limit(text: str, node_id: int, bits: int, signed: bool) -> int | None:
    value = number_in(text, node_id)
    if value is None:
        return None
    return _in_type(value, bits, signed) if text.strip().lower().startswith("0x") else value


def read_maker_file(path: Path) -> MakerFile:
    """Read a file. Raises InputError for one that cannot be read or holds no object."""
    try:
        text = path.read_bytes().decode("latin-1")
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path=path) from error
    sections: dict[str, dict[str, str]] = {}
    present: dict[str, str] = {}
    for line in map(str.strip, text.splitlines()):
        head = _SECTION.match(line)
        if head:
            present = sections.setdefault(head[1].lower(), {})
        elif "=" in line and not line.startswith(";"):
            name, _, value = line.partition("=")
            present[name.strip().lower()] = value.strip()
    texts: dict[Key, Mapping[str, str]] = {}
    for name, entry in sections.items():
        place = _OBJECT.match(name)
        if place is None:
            continue
        index = int(place[1], 16)
        if place[2] is not None:
            texts[index, int(place[2], 16)] = entry
        elif (number_in(entry.get("compactsubobj", "")) or 0) > 0:
            texts[index, 0] = {"datatype": "0x05", "accesstype": "ro", "defaultvalue": entry["compactsubobj"]}
            for subindex in range(1, (number_in(entry["compactsubobj"]) or 0) + 1):
                texts.setdefault((index, subindex), entry)
        elif not any(other.startswith(f"{name}sub") for other in sections):
            texts[index, 0] = entry
    if not texts:
        raise InputError("holds no object", path=path)
    return MakerFile(path, texts, sections.get("deviceinfo", {}))


# -- units of motion ---------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class MotionUnits:
    """One unit of the drive in turns of its shaft: rev of position, rev/s, rev/s². source: what states the velocity."""

    position_rev: float
    velocity_rev_s: float
    acceleration_rev_s2: float
    source: str = ""


FAULHABER, MAXON, NANOTEC, TRINAMIC, ORIENTAL, TECHNOSOFT = 0x147, 0xFB, 0x26C, 0x286, 0x2BE, 0x1A3
MINUTES = {FAULHABER, MAXON, NANOTEC, TRINAMIC, ORIENTAL}
"""Makers (1018h:1) whose manuals give velocity in turns per minute where no object of the file says it."""
TURN, INCREMENT, DEGREE, RADIAN, METRE = 0xB4, 0xB5, 0x41, 0x10, 0x01  # units of CiA 303-2
SECONDS_OF = {0x03: 1, 0x47: 60, 0x48: 3600}


def motion_units(maker: MakerFile, counts_per_rev: int, lead_m: float, axis: int = 1) -> MotionUnits:
    """The units of one axis by the file's defaults. counts_per_rev, lead_m: of the machine, for files that name counts or metres."""
    offset = 0x800 * (axis - 1)

    def told(index: int, subindex: int = 0) -> int:
        return maker.number(index + offset, subindex) or 0

    counts = float(counts_per_rev)
    if told(0x608F, 1) > 1:
        counts = told(0x608F, 1) / (told(0x608F, 2) or 1)
    if told(0x6093, 1) > 1 and told(0x6093, 2) > 1 and (told(0x6092, 1) or 1) != told(0x6093, 2):
        counts /= told(0x6093, 1) / told(0x6093, 2)
    turn_of = {TURN: 1.0, INCREMENT: 1 / counts, DEGREE: 1 / 360.0, RADIAN: 0.15915494309189535, METRE: 1 / lead_m}

    def power(code: int) -> float:
        exponent = code >> 24 & 0xFF
        return float(10.0 ** (exponent - 256 if exponent > 127 else exponent))

    position = 1 / counts
    if told(0x60A8) >> 16 & 0xFF in turn_of:
        position = turn_of[told(0x60A8) >> 16 & 0xFF] * power(told(0x60A8))
        turn_of[INCREMENT] = position if told(0x60A8) >> 16 & 0xFF == INCREMENT else turn_of[INCREMENT]
    minutes = maker.vendor in MINUTES
    velocity, source = (1 / 60.0, "the maker's manual: r/min") if minutes else (position, "no object: position units/s")
    if maker.vendor == TECHNOSOFT:  # 16.16 fixed point, increments per millisecond
        velocity, source = position * 1000.0 / 65536.0, "the maker's manual: 1/65536 increment/ms"
    si, notation, dimension = told(0x60A9), told(0x608B), told(0x608C)
    if si >> 16 & 0xFF in turn_of:
        velocity = turn_of[si >> 16 & 0xFF] * power(si) / SECONDS_OF.get(si >> 8 & 0xFF, 1)
        source = f"60A9h {si:08X}h"
    elif dimension in (0xA3, 0xA4, 0xAD):
        velocity = {0xA3: 1.0, 0xA4: 1 / 60.0, 0xAD: 1 / counts}[dimension] * float(
            10.0 ** (notation - 256 * (notation > 127))
        )
        source = f"608Ch {dimension:X}h"
    elif told(0x6094, 1) > 1 or told(0x6094, 2) > 1:
        velocity = told(0x6094, 1) / (told(0x6094, 2) or 1) / counts
        source = "6094h"
    acceleration = velocity  # per second
    if maker.vendor == FAULHABER:
        acceleration = 1.0
    elif maker.vendor == TECHNOSOFT:
        acceleration = position * 1e6 / 65536.0
    si = told(0x60AA)
    if si >> 16 & 0xFF in turn_of:
        acceleration = (
            turn_of[si >> 16 & 0xFF] * power(si) / SECONDS_OF.get(si >> 8 & 0xFF, 1) / SECONDS_OF.get(si & 0xFF, 1)
        )
    return MotionUnits(position, velocity, acceleration, source)


def modes_by_objects(maker: MakerFile, axis: int = 1) -> int:
    """Modes for which the dictionary has what a mode needs, as 6502h: for files that give 6502h no default."""
    offset = 0x800 * (axis - 1)

    def has(index: int, subindex: int = 0) -> bool:
        return (index + offset, subindex) in maker.texts

    modes = 0
    if has(0x607A) and has(0x6081) and has(0x6064):
        modes |= 0x01
    if has(0x60FF) and has(0x606C):
        modes |= 0x04
    if has(0x6098) and has(0x6099, 1):
        modes |= 0x20
    if has(0x60C1, 1):
        modes |= 0x40
    if has(0x60C2, 1) and has(0x607A) and not has(0x60C1, 1):
        modes |= 0x80
    return modes
