"""The reference of the axis file, made from its schema and the comments of hil/examples/axis.toml.

    python tests/study/axis_reference.py --write    puts it into hil/docs/axis_file.md

Keys, what a value may be, and defaults are those of the dataclasses that read the file; what a key means is the comment beside it in
the example. A comment begins "default:", or "default WHAT:" where the default depends on something else. A key without a comment is
an error.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from dataclasses import MISSING
from enum import Enum
from pathlib import Path
from typing import Any

from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.toml_schema import keys_of
from hil.axis import axis_file, connections, instrument
from hil.axis.backlash import BacklashConfig
from hil.axis.certificate import CertificateConfig
from hil.axis.lost_motion import LostMotionConfig
from hil.correction.bound import CorrectionBound
from hil.figures.alignment import Alignment
from hil.figures.material import Material
from hil.figures.uncertainty import UncertaintyInputs

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "hil/examples/axis.toml"
PAGE = ROOT / "hil/docs/axis_file.md"

DRIVE = (connections.DriveConfig,)
INSTRUMENT = (instrument.InstrumentConfig, instrument.DisplayConfig, instrument.ReplayConfig)
TABLES: dict[str, tuple[type, ...]] = {
    "axis": (axis_file._AxisSection, DriveLimits),
    "scaling": (AxisScaling,),
    "drive": DRIVE,
    "drive.homing": (connections.HomingConfig,),
    "instrument": INSTRUMENT,
    "instrument.fixed_air": (instrument.FixedAirConfig,),
    "instrument.alignment": (Alignment,),
    "instrument.material": (Material,),
    "measurement": (axis_file._Grid, axis_file.MeasurementConfig),
    "correction": (axis_file.CorrectionConfig, CorrectionBound),
    "straightness": (axis_file.StraightnessConfig,),
    "backlash": (BacklashConfig,),
    "lost_motion": (LostMotionConfig,),
    "conditions": (),
    "uncertainty": (UncertaintyInputs,),
    "certificate": (CertificateConfig,),
    "store": (axis_file.StoreConfig,),
}
"""By table of the file: the dataclasses that read it."""
KINDS = {"drive": connections._KEYS, "instrument": instrument._KEYS}
"""Tables whose keys depend on `backend` or `kind`, with the keys of each."""
HEAD = """\
# The axis file: every key

A key that is not listed here is refused. Nothing moves outside the limits of `[axis]`. Paths are relative to the folder of the file.
[hil/examples/axis.toml](../examples/axis.toml) is a complete example.

A line is `key = default` (allowed values): what it is. The key's name ends in its unit. A key that has neither "required" nor a
default has no value unless you give one. Without allowed values a key takes a number, or true or false; sizes, times and speeds may
not be negative. A name has letters, digits, `_`, `.` and `-`.
"""


def comments(text: str) -> dict[str, dict[str, str]]:
    """Of each table of the example, key -> comment. A line that is commented out counts as the rest; "" is the table's own."""
    found: dict[str, dict[str, str]] = {"": {}}
    table, key = "", ""
    for line in text.splitlines():
        header = re.match(r"(?:# )?\[([a-z_.]+)\]\s*(?:#\s*(.*))?$", line)
        entry = re.match(r"(?:# )?([a-z0-9_]+) = (?:\"[^\"]*\"|[^#\"]|\"[^\"]*\")*?(?:#\s*(.*))?$", line)
        if header:
            table, key = header[1], ""
            found[table] = {"": header[2] or ""}
        elif entry:
            key = entry[1]
            found[table].setdefault(key, entry[2] or "")
        elif key and (more := re.match(r"\s{8,}#\s*(.*)$", line)):
            found[table][key] += " " + more[1]
    return found


def meaning(comment: str) -> tuple[str | None, str]:
    """The default that a comment names, None where it is the schema's; and what it says of the key."""
    match = re.match(r"(?:default\b\s*([^:;]*)|(required))(?:[:;]\s*(.*))?$", comment)
    if match is None:
        return None, comment
    return (match[1] or match[2] or "").strip() or None, (match[3] or "").strip()


def shown(value: Any) -> str:
    """A default as it would stand in the file."""
    if value is MISSING:
        return "required"
    if value is None or value in ("", ()):
        return "none"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, Enum):
        return f'`"{value.value}"`'
    if isinstance(value, float):
        return f"`{value:g}`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value}`"


def brief(expected: str) -> str:
    """What a value may be, without what the head of the page, the key or the default says: number and sign, unit, true or false."""
    if expected == "true or false":
        return ""
    expected = re.sub(r",? >=? 0(?![.\d])", "", expected)
    words = re.sub(r", each a number in .*|^a number(?: in .*)?$| for none$", "", expected)
    words = re.sub(r"^(?:a number|a share|[^\s\d,-]\S*?)(?:, (?=-?[\d.])| (?=>))(.*?)(?: in .*)?$", r"\1", words)
    words = words.replace("a name of letters, digits, _ . -", "a name")
    return re.sub(
        r"\b(?:a whole number(?:, (?=-?\d)| (?=>))|an? (?=whole number))|^(?:an?|the) |(?<=each )a ", "", words
    )


def rows(keys: Mapping[str, tuple[str, Any]], said: Mapping[str, str]) -> list[str]:
    """A line for each key."""
    lines = []
    for key, (expected, default) in keys.items():
        if key not in said:
            raise LookupError(f"{EXAMPLE}: {key} has no line; the reference takes its meaning from there")
        words, what = meaning(said[key])
        value, literal = words or shown(default), words is None or re.fullmatch(r"`[^`]*`", words)
        notes = [brief(expected)]
        if value == "required":
            notes.insert(0, value)
        elif not literal and value != "none":
            notes.insert(0, f"default {value}")
        given = f" = {value.strip('`')}" if literal and value not in ("none", "required") else ""
        noted = "; ".join(note for note in notes if note)
        lines.append(f"- `{key}{given}`{noted and f' ({noted})'}{what and f': {what}'}")
    return lines


def page() -> str:
    """The whole page."""
    said = comments(EXAMPLE.read_text(encoding="utf-8"))
    if unlisted := set(said) - set(TABLES) - {""}:
        raise LookupError(f"tables of {EXAMPLE} that the reference does not know: {', '.join(sorted(unlisted))}")
    out = [HEAD]
    for table, kinds in TABLES.items():
        own = said[table]
        out += [f"## [{table}]", ""]
        if own[""]:
            out += [own[""], ""]
        keys = {key: entry for kind in kinds for key, entry in keys_of(kind).items()}
        tables = {name.removeprefix(f"{table}.") for name in TABLES if name.startswith(f"{table}.")}
        keys = {key: entry for key, entry in keys.items() if key not in tables}
        if table == "conditions":
            keys = {"load_kg": ("a list of numbers", None), "pos_<axis>_mm": ("a list of numbers", None)}
            own = own | {"pos_<axis>_mm": own["pos_y_mm"]}
        if table not in KINDS:
            out += [*rows(keys, own), ""]
            continue
        by_kind = {kind: names.split() for kind, names in KINDS[table].items()}
        common = set.intersection(*(set(names) for names in by_kind.values())) | {"backend", "kind"}
        out += rows({key: entry for key, entry in keys.items() if key in common}, own)
        selector = "backend" if table == "drive" else "kind"
        shared = [key for key in keys if key not in common and _kinds(key, by_kind)]
        for names in dict.fromkeys(_kinds(key, by_kind) for key in shared):
            which = {key: keys[key] for key in shared if _kinds(key, by_kind) == names}
            out += ["", f"With {selector} {' or '.join(names)}:", "", *rows(which, own)]
        out += [""]
    return "\n".join(out).rstrip() + "\n"


def _kinds(key: str, by_kind: Mapping[str, list[str]]) -> tuple[str, ...]:
    return tuple(kind for kind, names in by_kind.items() if key in names)


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(page(), encoding="utf-8")
    else:
        print(page(), end="")
