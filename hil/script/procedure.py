"""A user's own procedure: declared parameters, a plan of its moves, and rows as they are measured."""

from __future__ import annotations

import inspect
import re
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, dataclass_transform

from drivers.errors import BridgeError, InputError
from hil.desk.plan import OF_PROCEDURE, Move

if TYPE_CHECKING:
    from hil.script.axis import Axis

Row = Mapping[str, float]


@dataclass_transform(kw_only_default=True)
class Procedure(ABC):
    """Base class of your own procedures. As in a dataclass, annotated attributes are its parameters.

    A parameter is a float, int, bool, str or tuple[float, ...]. Its name ends in its unit (`dwell_s: float = 3.0`). It is an option of
    `hil run` (`--dwell-s 5`).
    """

    kind: ClassVar[str]
    """Name of its campaigns: "run-" and the name of the class."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.kind = OF_PROCEDURE + re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", cls.__name__).lower()
        dataclass(kw_only=True)(cls)

    @abstractmethod
    def plan(self, axis: Axis) -> Iterable[Move]:
        """The moves that `run` makes, each with its ends and its highest velocity. `run` cannot move the axis outside them.

        axis: not connected; its file is `axis.file`.
        """

    @abstractmethod
    def run(self, axis: Axis) -> Iterable[Row]:
        """Measure, and yield each row (`axis.read().row()`). It is on disk before the next is asked for. The run numbers ascend.

        axis: homed, with the datum set. When resumed, this begins anew; runs before `axis.first_run` are not written again.
        """


def file_of(procedure: type[Procedure]) -> str:
    """The file that a procedure is written in, "" for a class that was typed in."""
    return getattr(sys.modules.get(procedure.__module__), "__file__", None) or ""


def shown_file(procedure: type[Procedure]) -> str:
    """Its file as it is typed in the working directory."""
    path = Path(file_of(procedure))
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def line_of(procedure: type[Procedure], method: str) -> int | None:
    """The first line of one of its methods."""
    code = getattr(inspect.unwrap(getattr(procedure, method)), "__code__", None)
    return None if code is None else code.co_firstlineno


@contextmanager
def naming_the_line(procedure: type[Procedure], method: str) -> Iterator[None]:
    """An error of the user's code in the block becomes an InputError with file and line; another error of ours is noted the line."""
    from hil.effects.user_code import in_short, line_in  # noqa: PLC0415  (the effects load slowly)

    try:
        yield
    except BridgeError as error:
        line = line_in(error, file_of(procedure))
        if line is not None:
            error.add_note(f"in {method}() at {shown_file(procedure)}:{line}")
        raise
    except Exception as error:
        line = line_in(error, file_of(procedure)) or line_of(procedure, method)
        raise InputError(f"{method}() fails: {in_short(error)}", path=shown_file(procedure), line=line) from error


def values_of(procedure: Procedure) -> dict[str, Any]:
    """Its parameters as plain values, by name."""
    values = {one.name: getattr(procedure, one.name) for one in fields(procedure)}  # type: ignore[arg-type]
    return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
