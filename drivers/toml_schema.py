"""The reader of TOML files: dataclasses define the contents of a file; an error names file, line, key, value and what was expected.

A field's annotation is its schema. `msgspec` converts and checks single values: types, ranges, choices, patterns. Tables, lists, keys,
lines and error texts are handled here. An `Annotated` may carry the marks of `drivers.toml_types`, and functions that take value and
document and return the value checked. A `__post_init__` that compares fields raises `SchemaError` with the key at fault. Every error
is an `InputError` of one line.
"""

from __future__ import annotations

import difflib
import re
import textwrap
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from functools import cache, cached_property, partial
from pathlib import Path
from types import MappingProxyType, NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import msgspec

from drivers.errors import InputError
from drivers.files import read_text
from drivers.toml_lines import Place, lines_of
from drivers.toml_types import Key, Limits, SchemaError, Via

T = TypeVar("T")

_SHOWN = 60  # characters of a wrong value that an error quotes
_SHOWN_KEYS = 120  # characters of a list of keys in an error
_LONGEST_KEY = re.compile(r"(?<![^\s.,=#\[\]{}])(?:[^\s.,=#\[\]{}]++[ \t]*+\.[ \t]*+){32}")
"""A dotted key of more parts than any schema has: `tomllib` takes time with the square of their number. It is looked for from the
beginning of a part only: from every character, a number of 100,000 digits takes minutes."""
MOST_BYTES = 4 << 20
"""Longest file that is read; the largest map shipped has 40 kB."""
_UNITS = {
    "mm_s2": "mm/s²",
    "mm_s": "mm/s",
    "deg_s": "degrees/s",
    "um_s": "µm/s",
    "um_per_mm": "µm/mm",
    "um_per_m": "µm/m",
    "um_per_m_c": "µm/(m °C)",
    "ppm_per_k": "ppm/K",
    "mm": "mm",
    "mm_per_shaft_rev": "mm",
    "um": "µm",
    "nm": "nm",
    "s": "s",
    "deg": "degrees",
    "c": "°C",
    "hpa": "hPa",
    "percent": "%",
}


class Document:
    """One TOML file. context: data that functions in annotations need besides the value. Raises InputError for invalid TOML."""

    def __init__(self, path: str | Path, text: str, context: Any = None) -> None:
        self.path = Path(path)
        self.text = text
        self.context = context
        self._taken: set[str] = set()
        if len(self.text) > MOST_BYTES:
            raise InputError(f"has {len(self.text)} characters, expected at most {MOST_BYTES}", path=path)
        if found := _LONGEST_KEY.search(self.text):
            line = self.text.count("\n", 0, found.start()) + 1
            raise InputError("is not TOML that could be read: a key of too many parts", path=path, line=line)
        try:
            self.values: dict[str, Any] = tomllib.loads(self.text)
        except tomllib.TOMLDecodeError as error:
            match = re.search(r"at line (\d+)", str(error))
            what = re.sub(r" \(at .*\)$", "", str(error))
            line = int(match[1]) if match else self.text.rstrip().count("\n") + 1
            raise InputError(f"is not TOML: {what}", path=path, line=line) from error
        except (ValueError, RecursionError) as error:  # an integer of thousands of digits; brackets in brackets
            what = "is not TOML that could be read: a number too long, or too deeply nested"
            raise InputError(what, path=path) from error

    @classmethod
    def read(cls, path: str | Path) -> Document:
        """Read a file. Raises InputError naming file and line for one that cannot be read, is no text or is not TOML."""
        return cls(path, read_text(path, MOST_BYTES, expected="TOML"))

    def __contains__(self, name: str) -> bool:
        self._taken.add(name)
        return name in self.values

    def table(self, name: str) -> dict[str, Any]:
        """A table as written, unchecked; an empty one where there is none."""
        values = self.values.get(name)
        return values if isinstance(values, dict) else {}

    @cached_property
    def lines(self) -> dict[Place, int]:
        """The line of each table, key and member of a list."""
        return lines_of(self.text)

    def line(self, place: Place) -> int | None:
        """The line of a place, or of the nearest table around it that has one."""
        return next((self.lines[place[:size]] for size in range(len(place), 0, -1) if place[:size] in self.lines), None)

    def fail(self, place: str | Place, what: str) -> InputError:
        """An InputError for a place such as "drive.homing.method"; for a table where the place ends in ""."""
        parts = tuple(place.split(".")) if isinstance(place, str) else place
        own = max((at for at, part in enumerate(parts) if isinstance(part, str)), default=0)
        table, key = _dotted(parts[:own]), _dotted(parts[own:])
        said = [f"[{table}]" if table else "", key, what]
        return InputError(" ".join(filter(None, said)), path=self.path, line=self.line(parts))

    def load(
        self,
        kind: type[T],
        name: str | None = None,
        *,
        only: Collection[str] | None = None,
        needs: Collection[str] = (),
        beside: Collection[type] = (),
        usual: Mapping[str, Any] = MappingProxyType({}),
        required: bool = True,
    ) -> T:
        """A table of the file; without a name the whole file as one table.

        only: the keys that this table may hold, where the schema has more; needs: those it must; beside: schemas whose keys stand in
        the same table; usual: defaults by field, where they depend on other tables. Not required: a missing table is an empty one.
        """
        if name is not None and name not in self and required:
            raise InputError(f"lacks the table [{name}]", path=self.path)
        place: Place = () if name is None else (name,)
        values = self.values if name is None else self.values.get(name, {})
        if not is_dataclass(kind):
            return cast(T, self._build(kind, place, values))
        known = {key for each in (kind, *beside) for key in _schema(each) if only is None or key in only}
        build = partial(self._table, kind, place, values, known=known, needs=needs, usual=usual)
        return cast(T, self._guarded(kind, place, values, build))

    def finish(self) -> None:
        """Raise InputError for the first table of the file that was not loaded."""
        self._refuse_unknown((), self.values, self._taken)

    def _refuse_unknown(self, place: Place, values: Mapping[str, Any], known: Collection[str]) -> None:
        for key in values:
            if key not in known:
                near = difflib.get_close_matches(key, sorted(known), 1)
                every = textwrap.shorten(", ".join(sorted(known)), _SHOWN_KEYS, placeholder=" …")
                hint = f"the nearest known one is {near[0]}" if near else f"expected one of {every}"
                what = self.fail((*place, ""), f"unknown key {shown(key)}, {hint}").what
                raise InputError(what, path=self.path, line=self.line((*place, key)))

    def _table(
        self,
        kind: Any,
        place: Place,
        values: Any,
        *,
        known: Collection[str],
        needs: Collection[str] = (),
        usual: Mapping[str, Any] = MappingProxyType({}),
    ) -> Any:
        if not isinstance(values, dict):
            end = ("",) if isinstance(place[-1], str) else ()
            raise self.fail((*place, *end), f"is {shown(values)}, expected a table")
        self._refuse_unknown(place, values, known)
        found = dict(usual)
        for key, (name, annotation, optional) in _schema(kind).items():
            if key in values:
                found[name] = self._build(annotation, (*place, key), values[key])
            elif name not in usual and (not optional or key in needs):
                raise self._missing(annotation, place, key)
        return kind(**found)

    def _missing(self, annotation: Any, place: Place, key: str) -> InputError:
        if is_dataclass(_table_kind(annotation)):
            return InputError(f"lacks the table [{_dotted((*place, key))}]", path=self.path, line=self.line(place))
        return self.fail((*place, "") if place else (), f"lacks {key}, expected {_expected(annotation, key)}")

    def _build(self, annotation: Any, place: Place, value: Any) -> Any:
        return self._guarded(annotation, place, value, partial(self._convert, annotation, place, value))

    def _convert(self, annotation: Any, place: Place, value: Any) -> Any:
        kind, marks = _unwrap(annotation)
        inner = get_args(kind)
        built: Any
        if via := next((mark for mark in marks if isinstance(mark, Via)), None):
            built = via.convert(self._convert(via.kind, place, value), self)
        elif is_dataclass(kind):
            built = self._table(kind, place, value, known=_schema(cast(type, kind)))
        elif get_origin(kind) in (Union, UnionType) and isinstance(value, dict) and any(map(is_dataclass, inner)):
            built = self._convert(next(filter(is_dataclass, inner)), place, value)
        elif get_origin(kind) is tuple:
            alone = isinstance(value, dict) and is_dataclass(inner[0])  # one table alone counts as a list of one
            listed = [value] if alone else msgspec.convert(value, list)
            kinds = [inner[0]] * len(listed) if inner[-1] is ... else inner
            built = tuple(
                self._build(each, (*place, at), item) for at, (each, item) in enumerate(zip(kinds, listed, strict=True))
            )
        elif get_origin(kind) in (dict, Mapping):
            built = {
                self._build(inner[0], (*place, key), key): self._build(inner[1], (*place, key), item)
                for key, item in msgspec.convert(value, dict).items()
            }
        else:
            built = msgspec.convert(value, _limited(kind, marks))
        for mark in marks:
            built = mark(built, self) if callable(mark) and not isinstance(mark, Via) else built
        return built

    def _guarded(self, annotation: Any, place: Place, value: Any, build: Callable[[], Any]) -> Any:
        """Add the place in the file to any error."""
        try:
            with self.blaming(*place, table=isinstance(value, dict)):
                return build()
        except InputError as error:
            if error.path is not None:
                raise
            raise self.fail(place, f"is {shown(value)}: {error.what}") from error
        except (ValueError, ArithmeticError) as error:
            key = next((part for part in reversed(place) if isinstance(part, str)), "")
            raise self.fail(place, f"is {shown(value)}, expected {_expected(annotation, key)}") from error

    @contextmanager
    def blaming(self, *place: str | int, table: bool = True) -> Iterator[None]:
        """A `SchemaError` inside is raised again as an InputError with file and line; its key is one of the table at this place."""
        try:
            yield
        except SchemaError as error:
            raise self.fail((*place, error.key) if table or error.key else place, error.what) from error


def shown(value: object) -> str:
    """A wrong value as quoted in an error: on one line, and cut when it is long."""
    try:
        text = value if isinstance(value, str) and value.isidentifier() else repr(value)
    except ValueError:  # an integer with more digits than Python prints
        return "a number of thousands of digits"
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "…"


def either(words: Iterable[Any]) -> str:
    """The words as "a, b or c"."""
    *most, last = (str(word) for word in words)
    return f"{', '.join(most)} or {last}" if most else last


def _dotted(place: Place) -> str:
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)[1:]


@cache
def _schema(kind: Any) -> dict[str, tuple[str, Any, bool]]:
    """By key: name of the field, its annotation, whether it may be left out."""
    hints = get_type_hints(kind, include_extras=True)
    schema = {}
    for field in fields(kind):
        key = next((mark.name for mark in _unwrap(hints[field.name])[1] if isinstance(mark, Key)), field.name)
        if field.init and key:
            optional = field.default is not MISSING or field.default_factory is not MISSING
            schema[key] = (field.name, hints[field.name], optional)
    return schema


def keys_of(kind: Any) -> dict[str, tuple[str, Any]]:
    """By key of a table: what a value is expected to be, in words, and the default, `MISSING` where the key is required."""
    defaults = {field.name: field.default for field in fields(kind)}
    described = {}
    for key, (name, annotation, optional) in _schema(kind).items():
        default = defaults[name] if defaults[name] is not MISSING or not optional else None
        described[key] = (_expected(annotation, key), default)
    return described


@cache
def _unwrap(annotation: Any) -> tuple[Any, tuple[Any, ...]]:
    """The type itself and the marks of its `Annotated`s; X of X | None."""
    marks: tuple[Any, ...] = ()
    while True:
        if get_origin(annotation) is Annotated:
            marks += annotation.__metadata__
            annotation = annotation.__origin__
        elif get_origin(annotation) in (Union, UnionType) and NoneType in get_args(annotation):
            annotation = Union[tuple(arm for arm in get_args(annotation) if arm is not NoneType)]  # noqa: UP007
        else:
            return annotation, marks


@cache
def _limited(kind: Any, marks: tuple[Any, ...]) -> Any:
    """A type with its limits in msgspec's form."""
    for mark in marks:
        if isinstance(mark, Limits):
            given = {name: each for name in ("ge", "le", "pattern") if (each := getattr(mark, name)) is not None}
            kind = Annotated[kind, msgspec.Meta(**given)] if given else kind
    return kind


def _table_kind(annotation: Any) -> Any:
    """The type as it is in the file."""
    kind, marks = _unwrap(annotation)
    return next((_table_kind(mark.kind) for mark in marks if isinstance(mark, Via)), kind)


def _expected(annotation: Any, key: str) -> str:
    """The expectation of an annotation in words, with the unit that ends the key's name."""
    kind, marks = _unwrap(annotation)
    limits = [mark for mark in marks if isinstance(mark, Limits)]
    described = [mark.description for mark in limits if mark.description]
    via = next((mark for mark in marks if isinstance(mark, Via)), None)
    if via is not None and not described:
        return via.expected or _expected(via.kind, key)
    meta = limits[0] if limits else Limits()
    unit = next((_UNITS[key[at:]] for at in range(len(key)) if key[at:] in _UNITS and key[at - 1] == "_"), "")
    bounds = f", {meta.ge:.10g} to {meta.le:.10g}" if meta.ge is not None and meta.le is not None else ""
    inner = get_args(kind)
    if described:
        words = f"{described[0]} in {unit}" if unit and kind is float else described[0]
    elif get_origin(kind) is Literal:
        words = either(inner)
    elif isinstance(kind, type) and issubclass(kind, Enum):
        words = either(member.value for member in kind)
    elif get_origin(kind) is tuple:
        size = "" if inner[-1] is ... else f" of {len(inner)}"
        tables = is_dataclass(_table_kind(inner[0]))
        words = "a list of tables" if tables else f"a list{size}, each {_expected(inner[0], key)}"
    else:
        plain = {
            bool: "true or false",
            int: "a whole number",
            float: "seconds" if unit == "s" else unit or "a number",
            str: "a text",
        }
        table = get_origin(kind) in (dict, Mapping) or is_dataclass(kind)
        words = plain.get(kind, "a table" if table else "a number or a text") + bounds
    return words
