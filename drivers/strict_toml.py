"""Strict reading of TOML: every key is asked for by somebody, every complaint names file, line, key, value and what was expected.

What may go in: what the maps of more than one wire need (register maps, maps of a drive's own correction table); it knows nothing of
registers or objects. Errors are `InputError`s.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

from drivers.errors import InputError

T = TypeVar("T")
E = TypeVar("E", bound=Enum)
REQUIRED = object()
_HEADER = re.compile(r"\s*(?P<open>\[\[?)\s*(?P<name>[^\[\]]+?)\s*\]")
_KEY = re.compile(r"\s*\"?(?P<key>[\w-]+)\"?\s*=")


class Document:
    """One TOML file: its values, and the line on which each key stands."""

    def __init__(self, path: Path, text: str) -> None:
        self.path = path
        try:
            self._values = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            match = re.search(r"at line (\d+)", str(error))
            what = re.sub(r" \(at .*\)$", "", str(error))
            raise InputError(f"is not TOML: {what}", path=path, line=int(match[1]) if match else None) from error
        self._lines = _lines_of_keys(text)

    @classmethod
    def read(cls, path: Path) -> Document:
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be read: {error.strerror}", path=path) from error
        except UnicodeDecodeError as error:
            raise InputError("is not UTF-8 text", path=path) from error
        return cls(path, text)

    def root(self) -> Section:
        return Section(self, "", self._values)

    def fail(self, place: str, what: str) -> InputError:
        """An error at `place`, e.g. "registers.status.type", on the line of its nearest part that has one."""
        line: int | None = None
        nearest = place
        while nearest and (line := self._lines.get(nearest)) is None:
            nearest = re.sub(r"(\[\d+\]|(^|\.)[^.\[\]]+)$", "", nearest)
        return InputError(f"{place} {what}" if place else what, path=self.path, line=line)


def _lines_of_keys(text: str) -> dict[str, int]:
    lines: dict[str, int] = {}
    counts: dict[str, int] = {}
    prefix = ""
    for number, line in enumerate(text.splitlines(), start=1):
        if match := _HEADER.match(line):
            name = match["name"].replace('"', "")
            if match["open"] == "[[":
                counts[name] = counts.get(name, -1) + 1
                lines.setdefault(name, number)
                name = f"{name}[{counts[name]}]"
            prefix = name
            lines[prefix] = number
        elif match := _KEY.match(line):
            lines.setdefault(f"{prefix}.{match['key']}" if prefix else match["key"], number)
    return lines


class Section:
    """One table of the document; keys are taken out one by one, and what is left over is an error."""

    def __init__(self, document: Document, place: str, values: object) -> None:
        self.document = document
        self.place = place
        if not isinstance(values, dict):
            raise document.fail(place, f"is {values!r}, expected a table")
        self._values: dict[str, Any] = dict(values)
        self._known: list[str] = []

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def holds_table(self, key: str) -> bool:
        return isinstance(self._values.get(key), dict)

    def at(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key

    def fail(self, key: str, what: str) -> InputError:
        return self.document.fail(self.at(key), what)

    def take(self, key: str, convert: Callable[[Any], T], expected: str, default: Any = REQUIRED) -> T:
        """Take a key out; `convert` raises ValueError or TypeError for what is not `expected`."""
        self._known.append(key)
        if key not in self._values:
            if default is REQUIRED:
                raise self.document.fail(self.place, f"lacks {key}, expected {expected}")
            return default  # type: ignore[no-any-return]
        value = self._values.pop(key)
        try:
            return convert(value)
        except InputError as error:
            raise self.fail(key, f"is {value!r}: {error.what}") from error
        except (TypeError, ValueError) as error:
            raise self.fail(key, f"is {value!r}, expected {expected}") from error

    def child(self, key: str, *, required: bool = True) -> Section:
        self._known.append(key)
        if key not in self._values and required:
            raise self.document.fail(self.place, f"lacks the table {self.at(key)}")
        return Section(self.document, self.at(key), self._values.pop(key, {}))

    def children(self, key: str, *, required: bool = True) -> list[Section]:
        """The tables of a list; one table alone counts as a list of one."""
        self._known.append(key)
        if key not in self._values and required:
            raise self.document.fail(self.place, f"lacks {key}, expected a list of tables")
        values = self._values.pop(key, [])
        if isinstance(values, dict):
            values = [values]
        if not isinstance(values, list) or (required and not values):
            raise self.fail(key, f"is {values!r}, expected a list of tables")
        return [Section(self.document, f"{self.at(key)}[{index}]", value) for index, value in enumerate(values)]

    def named(self) -> list[tuple[str, Section]]:
        """All members of a table of tables, by name."""
        names = list(self._values)
        return [(name, self.child(name)) for name in names]

    def finish(self) -> None:
        """Raise for the first key that nobody asked for."""
        for key in self._values:
            raise self.fail(key, f"is an unknown key, expected one of: {', '.join(dict.fromkeys(self._known))}")


def text(value: Any) -> str:
    if not isinstance(value, str) or not value.strip():
        raise ValueError
    return value


def flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


def whole(low: int, high: int) -> Callable[[Any], int]:
    def convert(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ValueError
        return value

    return convert


def number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError
    return float(value)


def positive(value: Any) -> float:
    if not number(value) > 0:
        raise ValueError
    return float(value)


def interval(value: Any) -> tuple[float, float]:
    low, high = (number(item) for item in value)
    if not low <= high:
        raise ValueError
    return low, high


def sign(value: Any) -> int:
    """1 or -1."""
    if number(value) not in (1.0, -1.0):
        raise ValueError
    return int(value)


def take_enum(section: Section, key: str, kind: type[E]) -> E:
    """A member of an Enum by its value."""
    return section.take(key, kind, " or ".join(str(member.value) for member in kind))
