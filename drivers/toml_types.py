"""Marks for annotations of a dataclass that is read from a TOML file: limits, names of keys, conversions, kinds of values.

No file is read here, and no library imported: `drivers.toml_schema` is the reader.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sized
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

from drivers.errors import InputError

_LARGEST = 1e9  # mm, mm/s, s, µm: larger than any axis or any reasonable wait
_SMALLEST = 1e-9  # smallest value where one > 0 is required


class SchemaError(InputError):
    """A value is inconsistent with the others of its table; `key` is the one at fault, "" the table itself."""

    def __init__(self, key: str, what: str) -> None:
        self.key = key
        super().__init__(what)


@dataclass(frozen=True)
class Limits:
    """Limits of a single value: least, greatest, a regular expression of the whole text; and their description in an error."""

    ge: float | None = None
    le: float | None = None
    pattern: str | None = None
    description: str = ""


@dataclass(frozen=True)
class Key:
    """The name of a field in the file where it differs; "" for a field that is never in a file."""

    name: str


@dataclass(frozen=True)
class Via:
    """The value is read as `kind` and then converted; a ValueError becomes an error with the expectation."""

    kind: Any
    convert: Callable[[Any, Any], Any]
    expected: str = ""


def _text(value: str, _: Any) -> str:
    if not value.strip() or not value.isprintable():
        raise ValueError
    return value


def _beside(value: str, document: Any) -> Path:
    folder: Path = document.path.resolve().parent
    return folder / value


def not_empty(value: Sized, _: Any) -> Sized:
    """The value, if it has a member. Raises ValueError for an empty one."""
    if not value:
        raise ValueError
    return value


def one_of(*choices: Any) -> Via:
    """One of these values, and of the same type."""
    return Via(Literal[choices], lambda value, _: value)


def _ratio(value: int | str, _: Any) -> Fraction:
    if not re.fullmatch(r"\d{1,9}(/\d{1,9})?", str(value)) or not Fraction(str(value)) > 0:
        raise ValueError
    return Fraction(str(value))


Number = Annotated[float, Limits(ge=-_LARGEST, le=_LARGEST, description="a number")]
Positive = Annotated[float, Limits(ge=_SMALLEST, le=_LARGEST, description="a number > 0")]
NotNegative = Annotated[float, Limits(ge=0.0, le=_LARGEST, description="a number >= 0")]
Share = Annotated[float, Limits(ge=0.0, le=1.0, description="a share, 0 to 1")]
Count = Annotated[int, Limits(ge=0, le=2**31, description="a whole number >= 0")]
Sign = Annotated[int, one_of(1, -1)]
Text = Annotated[str, _text]
Name = Annotated[
    str, Limits(pattern=r"\A[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}\Z", description="a name of letters, digits, _ . -")
]
"""A name that is part of file names, of column names and of messages."""
Folder = Annotated[Path, Via(Text, _beside, "a folder")]
File = Annotated[Path, Via(Text, _beside, "a file")]
"""A path, absolute; in the file relative to the file's own folder."""
Ratio = Annotated[Fraction, Via(int | str, _ratio, 'a whole number or a fraction such as "5/2"')]
