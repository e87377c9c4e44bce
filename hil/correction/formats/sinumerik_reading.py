"""SINUMERIK compensation tables read back: what the lines of an EEC or CEC file say, put together as tables.

Sources and signs: hil.correction.formats.sinumerik.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from drivers.errors import InputError
from hil.correction.formats.common import evenly, number, numbered_lines, one_directional_set, table_set
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet
from hil.records.rows import UM_PER_MM

_Key = TypeVar("_Key")
_Value = TypeVar("_Value")

DOWNWARDS = " ; reference point approached in -"
"""Ends the comment that says the backlash, where it is so."""
_FRAME = re.compile(r"%.*|CHANDATA\(\d+\)|M17|M30|M0?2|NEWCONF", re.IGNORECASE)
_EEC_VALUE = re.compile(r"\$AA_ENC_COMP\[\s*(\d{1,9})\s*,\s*(\d{1,9})\s*,\s*(\w+)\s*\]\s*=\s*(\S+)$", re.IGNORECASE)
_EEC_KEY = re.compile(
    r"\$AA_ENC_COMP_(STEP|MIN|MAX|IS_MODULO)\[\s*(\d{1,9})\s*,\s*(\w+)\s*\]\s*=\s*(\S+)$", re.IGNORECASE
)
_BACKLASH = re.compile(r"\$MA_BACKLASH\[\s*(\d{1,9})\s*,\s*(\w+)\s*\]\s*=\s*([-+.\dEe]+)", re.IGNORECASE)
_CEC_VALUE = re.compile(r"\$AN_CEC\s*\[\s*(\d{1,9})\s*[,.]\s*(\d{1,9})\s*\]\s*=\s*(\S+)$", re.IGNORECASE)
_CEC_KEY = re.compile(
    r"\$AN_CEC_(INPUT_AXIS|OUTPUT_AXIS|STEP|MIN|MAX|DIRECTION|MULT_BY_TABLE|IS_MODULO)\s*\[\s*(\d{1,9})\s*\]\s*=\s*(\S+)$",
    re.IGNORECASE,
)


@dataclass
class _Found:
    """One table while its lines are gathered."""

    line: int
    keys: dict[str, str] = field(default_factory=dict)
    values: dict[int, float] = field(default_factory=dict)

    def key(self, name: str, default: str | None = None) -> float:
        if name not in self.keys and default is None:
            raise InputError(f"the table that begins here lacks {name}", line=self.line)
        return number(self.keys.get(name, default or ""), name, self.line)

    def curve(self) -> SingleTable:
        """The correction over position."""
        if self.key("IS_MODULO", "0"):
            raise InputError("the table that begins here is of a modulo axis, expected a linear one", line=self.line)
        low, high, step = self.key("MIN"), self.key("MAX"), self.key("STEP")
        if not (step > 0 and high > low):
            raise InputError(f"MIN {low:g}, MAX {high:g}, STEP {step:g} make no grid", line=self.line)
        points = np.floor((high - low) / step + 1e-6) + 1
        if points != len(self.values) or sorted(self.values) != list(range(len(self.values))):
            raise InputError(
                f"MIN, MAX and STEP make points 0 to {points - 1:.0f}, the table holds {len(self.values)}"
                f" from {min(self.values, default=0)} to {max(self.values, default=0)}",
                line=self.line,
            )
        values = np.array([self.values[point] for point in range(len(self.values))])
        return SingleTable(evenly(low, step, len(values)), -values * UM_PER_MM)


@dataclass
class _Reader:
    """What a file holds, gathered line by line."""

    eec: dict[tuple[int, str], _Found] = field(default_factory=dict)
    cec: dict[int, _Found] = field(default_factory=dict)
    backlash_um: float = 0.0
    downwards: bool = False

    def read(self, raw: str, line_number: int) -> None:
        if match := _BACKLASH.search(raw):
            self.backlash_um = number(match[3], "MD32450", line_number) * UM_PER_MM
            self.downwards = raw.rstrip().endswith(DOWNWARDS.strip())
            return
        line = raw.partition(";")[0].strip()
        if not line or _FRAME.fullmatch(line):
            return
        if match := _EEC_VALUE.match(line):
            found = self._eec(match[1], match[3], line_number)
            _once(found.values, int(match[2]), number(match[4], "value", line_number), line_number)
        elif match := _EEC_KEY.match(line):
            _once(self._eec(match[2], match[3], line_number).keys, match[1].upper(), match[4], line_number)
        elif match := _CEC_VALUE.match(line):
            found = self._cec(match[1], line_number)
            _once(found.values, int(match[2]), number(match[3], "value", line_number), line_number)
        elif match := _CEC_KEY.match(line):
            _once(self._cec(match[2], line_number).keys, match[1].upper(), match[3], line_number)
        else:
            raise InputError(f"{line!r} is no line of a compensation table", line=line_number)

    def _eec(self, encoder: str, axis: str, line: int) -> _Found:
        return self.eec.setdefault((int(encoder), axis.upper()), _Found(line))

    def _cec(self, index: str, line: int) -> _Found:
        return self.cec.setdefault(int(index), _Found(line))


def read(text: str) -> TableSet:
    """The tables of an EEC or CEC file with one axis in it.

    Raises InputError with the line for lines that are not understood, tables that do not fit together, more than one axis.
    """
    reader = _Reader()
    for line_number, raw in numbered_lines(text):
        reader.read(raw, line_number)
    if reader.eec and reader.cec:
        raise InputError("holds EEC and CEC tables, expected one kind")
    if reader.cec:
        return _cec_set(reader.cec)
    if len(reader.eec) > 1:
        raise InputError(f"holds EEC tables of {len(reader.eec)} axes or encoders, expected one")
    if not reader.eec:
        raise InputError("holds no compensation table ($AA_ENC_COMP or $AN_CEC)")
    curve = next(iter(reader.eec.values())).curve()
    if reader.backlash_um:
        plus_um = curve.value_um + (reader.backlash_um if reader.downwards else 0.0)
        return one_directional_set(curve.position_mm, plus_um, reader.backlash_um)
    return table_set(curve.position_mm, curve.value_um, curve.value_um)


def _once(into: dict[_Key, _Value], key: _Key, value: _Value, line: int) -> None:
    if key in into:
        raise InputError(f"gives {key} a second time", line=line)
    into[key] = value


def _cec_set(found: dict[int, _Found]) -> TableSet:
    own: dict[int, SingleTable] = {}
    cross: tuple[str, SingleTable] | None = None
    inputs = {table.keys.get("INPUT_AXIS", "").upper() for table in found.values()}
    if len(inputs) != 1:
        raise InputError(f"holds tables of the input axes {', '.join(sorted(inputs))}, expected one")
    for table in found.values():
        if table.key("MULT_BY_TABLE", "0"):
            raise InputError("the table that begins here is multiplied by another one", line=table.line)
        direction, target = table.key("DIRECTION"), table.keys.get("OUTPUT_AXIS", "").strip("()")
        curve = table.curve()
        if target.upper() != next(iter(inputs)).strip("()"):
            if direction or cross is not None:
                raise InputError(
                    "the table that begins here corrects another axis by direction, or a second one", line=table.line
                )
            cross = (target, curve)
            continue
        if direction not in (0, 1, -1):
            raise InputError(f"DIRECTION is {direction:g}, expected 0, 1 or -1", line=table.line)
        for sign in (1, -1) if direction == 0 else (int(direction),):
            if sign in own:
                raise InputError(f"the table that begins here is a second one for direction {sign:+d}", line=table.line)
            own[sign] = curve
    if set(own) != {1, -1}:
        have = ", ".join(f"{sign:+d}" for sign in own) or "none"
        raise InputError(f"has CEC tables for direction {have}, expected both (or direction 0)")
    nodes = np.union1d(own[1].position_mm, own[-1].position_mm)
    pitch = DirectionalTable(nodes, own[1].at(nodes), own[-1].at(nodes))
    if cross is None:
        return TableSet(TableMode.BIDIRECTIONAL, pitch)
    return TableSet(TableMode.BIDIRECTIONAL, pitch, straightness=cross[1], straightness_axis=cross[0])
