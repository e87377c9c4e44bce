"""A file with a user's procedure: its class, and the parameters that the class declares."""

from __future__ import annotations

import argparse
import ast
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Any, get_type_hints

from drivers.errors import InputError
from drivers.files import read_text
from hil.effects.user_code import in_short, load_code
from hil.script.procedure import Procedure, file_of, naming_the_line, shown_file

EXPECTED = "a class of hil.Procedure"


def load_procedure(path: str | Path) -> type[Procedure]:
    """The procedure in a Python file, which is run. Raises InputError, naming file and line, for a file that fails or holds none,
    several, or one that lacks a method."""
    module = load_code(path, EXPECTED)
    own = [one for one in vars(module).values() if isinstance(one, type) and issubclass(one, Procedure)]
    found = [one for one in dict.fromkeys(own) if one.__module__ == module.__name__]
    if not found:
        raise InputError(f"holds no procedure, expected {EXPECTED}", path=path)
    if len(found) > 1:
        names = " and ".join(one.__name__ for one in found)
        raise InputError(f"holds {names}, expected one class of hil.Procedure", path=path, line=class_line(found[1]))
    procedure = found[0]
    lacking = " and ".join(f"{name}()" for name in sorted(procedure.__abstractmethods__))
    if lacking:
        raise InputError(f"{procedure.__name__} has no {lacking}", path=path, line=class_line(procedure))
    return procedure


def class_line(procedure: type[Procedure], attribute: str = "") -> int | None:
    """The line of a class in its file, or of one of its attributes."""
    for node in ast.walk(ast.parse(read_text(Path(file_of(procedure))))):
        if isinstance(node, ast.ClassDef) and node.name == procedure.__name__:
            inside = [one for one in node.body if isinstance(one, ast.AnnAssign)]
            named = [one.lineno for one in inside if isinstance(one.target, ast.Name) and one.target.id == attribute]
            return named[0] if named else node.lineno
    return None


# -- values of a command line ------------------------------------------------------------------------------------------
def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(_number(part) for part in text.split(","))


@dataclass(frozen=True)
class ValueKind:
    """A kind of value. said: in messages; read: from a word of the command line, raises ValueError; types: of a value in the code."""

    said: str
    read: Callable[[str], Any]
    types: tuple[type, ...]


KINDS: Mapping[Any, ValueKind] = {
    float: ValueKind("a number", _number, (float, int)),
    int: ValueKind("a whole number", int, (int,)),
    str: ValueKind("a text", str, (str,)),
    bool: ValueKind("True or False", bool, (bool,)),
    tuple[float, ...]: ValueKind("numbers with commas, as 20,100", _numbers, (tuple,)),
}


@dataclass(frozen=True)
class Parameter:
    """A declared parameter. usual: its value unless one is given, MISSING where one must be."""

    name: str
    kind: ValueKind
    usual: Any

    @property
    def shown(self) -> str:
        """Its usual value as a command line and a field of the screen take it, "" without one."""
        if self.usual is MISSING:
            return ""
        return ",".join(f"{one:g}" for one in self.usual) if isinstance(self.usual, tuple) else str(self.usual)

    def add_to(self, group: argparse._ArgumentGroup) -> None:
        """Add it as an option, with and without underscores."""
        names = dict.fromkeys((f"--{self.name.replace('_', '-')}", f"--{self.name}"))
        required = self.usual is MISSING
        text = f"{self.kind.said} ({'required' if required else f'default {self.shown}'})".replace("%", "%%")
        more: dict[str, Any] = {"dest": f"parameter {self.name}", "default": argparse.SUPPRESS, "required": required}
        if bool in self.kind.types:
            group.add_argument(*names, **more, action=argparse.BooleanOptionalAction, help=text)
        else:
            group.add_argument(*names, **more, type=self._read, metavar="VALUE", help=text)

    def _read(self, word: str) -> Any:
        try:
            return self.kind.read(word)
        except ValueError as error:
            raise argparse.ArgumentTypeError(f"is {word!r}, expected {self.kind.said}") from error


def parameters_of(procedure: type[Procedure]) -> tuple[Parameter, ...]:
    """The declared parameters. Raises InputError, naming file and line, for a type that no word of a command line becomes, and for
    a default that is not of its type."""
    try:
        hints = get_type_hints(procedure)
    except (NameError, TypeError) as error:
        what = f"{procedure.__name__} has a parameter of an unknown type: {in_short(error)}"
        raise InputError(what, path=shown_file(procedure), line=class_line(procedure)) from error
    found = []
    for one in fields(procedure):  # type: ignore[arg-type]
        kind, usual = KINDS.get(hints[one.name]), one.default
        place: dict[str, Any] = {"path": shown_file(procedure), "line": class_line(procedure, one.name)}
        if kind is None:
            said = inspect.formatannotation(hints[one.name])
            raise InputError(
                f"{one.name} is of type {said}, expected float, int, bool, str or tuple[float, ...]", **place
            )
        wrong = usual is not MISSING and (
            not isinstance(usual, kind.types) or (isinstance(usual, bool) and bool not in kind.types)
        )
        if wrong:
            raise InputError(f"{one.name} is {usual!r}, expected {kind.said}", **place)
        found.append(Parameter(one.name, kind, usual))
    return tuple(found)


def made_from(procedure: type[Procedure], args: argparse.Namespace) -> Procedure:
    """The procedure with the parameters of a command line. Raises InputError where its own `__post_init__` objects."""
    given = {
        name.removeprefix("parameter "): value for name, value in vars(args).items() if name.startswith("parameter ")
    }
    with naming_the_line(procedure, "__init__"):
        return procedure(**given)
