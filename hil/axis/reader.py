"""A TOML table as a person wrote it: keys are taken out one by one, checked, and what is left over is an error with its line.

What may go in: finding lines again, and the kinds of values that more than one section of an axis file has.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeVar

from drivers.errors import InputError

T = TypeVar("T")
REQUIRED: Any = object()
_LARGEST = 1e9  # mm, mm/s, s, µm: no axis, and nothing that could still be waited for, is larger
_SMALLEST = 1e-9  # of what must be > 0
_SHOWN = 60  # characters of a wrong value that an error quotes

_HEADER = re.compile(r"\s*\[{1,2}(?P<name>[^\[\]=,#]+)\]{1,2}\s*(#.*)?$")


class Table:
    """One TOML table; keys are taken out one by one, and what is left over is an error."""

    def __init__(self, path: Path, text: str, name: str, values: object) -> None:
        self.path = path
        self._text = text
        self.name = name
        if not isinstance(values, dict):
            raise InputError(f"[{name}] is {shown(values)}, expected a table", path=path, line=self._line(None))
        self._values: dict[str, Any] = dict(values)

    def _line(self, key: str | None) -> int | None:
        """The line of a key (as `key =`, `[table.key]` or `table.key =`), or of the table's own header; None if not found."""
        own = f"{self.name}.{key}" if self.name and key else key or self.name
        parent, _, leaf = self.name.rpartition(".")
        here = "" if key is None else rf"\s*[\"']?{re.escape(key)}[\"']?\s*(=|\.)"
        dotted = rf"\s*{re.escape(own)}\s*(=|\.)"
        inline = rf"\s*[\"']?{re.escape(leaf)}[\"']?\s*(=|\.)"
        table = ""
        for number, line in enumerate(self._text.split("\n"), start=1):
            if match := _HEADER.match(line):
                table = re.sub(r"[\s\"']", "", match["name"])
                if table == own or table.startswith(f"{own}."):
                    return number
            elif (
                (key is not None and table == self.name and re.match(here, line))
                or (table == "" and re.match(dotted, line))
                or (parent and table == parent and re.match(inline, line))
            ):
                return number
        return None if key is None or not self.name else self._line(None)

    def fail(self, key: str, what: str) -> InputError:
        return InputError(f"[{self.name}] {key} {what}", path=self.path, line=self._line(key))

    def take(self, key: str, convert: Callable[[Any], T], expected: str, default: Any = REQUIRED) -> T:
        """Take a key out; `convert` raises ValueError or TypeError for what is not `expected`."""
        if key not in self._values:
            if default is REQUIRED:
                raise InputError(
                    f"[{self.name}] lacks {key}, expected {expected}", path=self.path, line=self._line(None)
                )
            return default  # type: ignore[no-any-return]
        value = self._values.pop(key)
        try:
            return convert(value)
        except InputError as error:
            raise self.fail(key, f"is {shown(value)}: {error.what}") from error
        except (TypeError, ValueError, ArithmeticError) as error:
            raise self.fail(key, f"is {shown(value)}, expected {expected}") from error

    def child(self, key: str, *, required: bool = True) -> Table:
        if key not in self._values and required:
            raise InputError(f"lacks the table [{key}]", path=self.path)
        name = f"{self.name}.{key}" if self.name else key
        return Table(self.path, self._text, name, self._values.pop(key, {}))

    def keys_left(self) -> list[str]:
        """The keys not taken out yet."""
        return list(self._values)

    def finish(self, known: Sequence[str] = ()) -> None:
        for key in self._values:
            hint = f" (known: {', '.join(known)})" if known else ""
            place = f"[{self.name}] " if self.name else ""
            raise InputError(f"{place}unknown key {shown(key)}{hint}", path=self.path, line=self._line(key))


def shown(value: object) -> str:
    """A wrong value as an error quotes it: on one line, and not all of it when it is long."""
    try:
        text = value if isinstance(value, str) and value.isidentifier() else repr(value)
    except ValueError:  # an integer with more digits than Python is willing to print
        return "a number of thousands of digits"
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "…"


def finite(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= _LARGEST:
        raise ValueError
    return float(value)


def positive(value: Any) -> float:
    number = finite(value)
    if not number >= _SMALLEST:
        raise ValueError
    return number


def not_negative(value: Any) -> float:
    number = finite(value)
    if number < 0:
        raise ValueError
    return number


def between(low: float, high: float) -> Callable[[Any], float]:
    """A number within limits, both included."""

    def convert(value: Any) -> float:
        number = finite(value)
        if not low <= number <= high:
            raise ValueError
        return number

    return convert


def share(value: Any) -> float:
    number = finite(value)
    if not 0 <= number <= 1:
        raise ValueError
    return number


def whole(low: int, high: int) -> Callable[[Any], int]:
    def convert(value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise ValueError
        return value

    return convert


def choice(*choices: Any) -> Callable[[Any], Any]:
    def convert(value: Any) -> Any:
        for choice in choices:
            if type(value) is type(choice) and value == choice:
                return choice
        raise ValueError

    return convert


def text(value: Any) -> str:
    if not isinstance(value, str) or not value.strip() or not value.isprintable():
        raise ValueError
    return value


def name(value: Any) -> str:
    """A name that is part of file names, of column names and of messages."""
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}", value):
        raise ValueError
    return value


def flag(value: Any) -> bool:
    if not isinstance(value, bool):
        raise TypeError
    return value


def ratio(value: Any) -> Fraction:
    if isinstance(value, bool) or not re.fullmatch(r"\d{1,9}(/\d{1,9})?", str(value)):
        raise ValueError
    ratio = Fraction(str(value))
    if ratio <= 0:
        raise ValueError
    return ratio


def numbers(value: Any) -> tuple[float, ...]:
    if not isinstance(value, list) or not value:
        raise ValueError
    return tuple(finite(item) for item in value)
