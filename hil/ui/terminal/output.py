"""Output of the verbs: tables and facts on standard output, JSON files."""

from __future__ import annotations

import argparse
import io
import json
import math
import os
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import Any, Literal, TextIO

from drivers.files import replace_file
from hil.correction.sealed import Binding
from hil.desk.result import Result

Align = Literal["left", "right"]
PIPE_WIDTH = 140
"""Width of a table in a file or pipe where COLUMNS is not set, characters."""


STANDARD_OUTPUT = "-"
_json_to: TextIO | None = None


@contextmanager
def json_alone_on_output() -> Iterator[None]:
    """Inside the block standard output is kept for `--json -`; everything that is printed goes to standard error."""
    global _json_to  # noqa: PLW0603  (one process, one standard output)
    _json_to = sys.stdout
    try:
        with redirect_stdout(sys.stderr):
            yield
    finally:
        _json_to.flush()
        _json_to = None


@contextmanager
def plan_as_json(path: str) -> Iterator[None]:
    """What a dry run prints inside the block, printed at its end, and as JSON: {"dry_run": true, "plan": its lines}."""
    printed = io.StringIO()
    try:
        with redirect_stdout(printed):
            yield
    finally:
        print(printed.getvalue(), end="")
    lines = [line.rstrip() for line in printed.getvalue().splitlines() if line.strip()]
    write_json(path, {"dry_run": True, "plan": lines})


def write_json(path: str | Path, obj: object) -> None:
    """Write `obj` as UTF-8 JSON, whole or not at all; "-" is standard output. NaN and infinity become null.

    Raises InputError when it cannot be written.
    """
    text = json.dumps(_plain(obj), indent=2, ensure_ascii=False, allow_nan=False)
    if path == STANDARD_OUTPUT:
        print(text, file=_json_to or sys.stdout)
        return
    replace_file(path, (text + "\n").encode("utf-8"))


def finish(args: argparse.Namespace, result: Result) -> int:
    """Write the report and the JSON that the options ask for; the exit status of this result."""
    if getattr(args, "report", None):
        result.report(args.report)
    if args.json:
        write_json(args.json, result.form())
    return 0 if result.good else 1


def say(text: str) -> None:
    """A sentence on standard error, on one line."""
    print(f"hil: {' '.join(text.split())}", file=sys.stderr)


def number(value: float | None, decimals: int = 2) -> str:
    """A figure for a table cell; a dash where there is none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def from_here(path: Path) -> str:
    """A path as it is typed in the working directory; whole where it lies elsewhere."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def times(count: int) -> str:
    """ "once", "twice", "3 times" …"""
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


def print_table(
    columns: Sequence[str | tuple[str, Align]],
    rows: Iterable[Sequence[str]],
    title: str | None = None,
    *,
    paths: str | None = None,
) -> None:
    """A table on standard output. The first column is left aligned, the others right, unless a column says otherwise.

    paths: a column of paths, broken between their names as long as each fits; the other columns wrap first
    """
    from rich import box  # noqa: PLC0415  (slow to import, and first needed when a job is done)
    from rich.console import Console  # noqa: PLC0415  (as above)
    from rich.table import Table  # noqa: PLC0415  (as above)

    console = Console(highlight=False, markup=False, emoji=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, emoji=False, width=_pipe_width())
    cells = [list(row) for row in rows]
    named = [
        column if isinstance(column, tuple) else (column, "right" if i else "left") for i, column in enumerate(columns)
    ]
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    fits = False
    if paths is not None:
        at = [name for name, _ in named].index(paths)
        others = sum(_longest_word([name, *(row[i] for row in cells)]) for i, (name, _) in enumerate(named) if i != at)
        room = console.width - 3 * len(named) - 1 - others
        for row in cells:
            row[at] = _between_names(row[at], room)
        fits = all(len(line) <= room for row in cells for line in row[at].splitlines())
    for name, align in named:
        table.add_column(name, justify=align, overflow="fold", no_wrap=fits and name == paths)
    for row in cells:
        table.add_row(*row)
    console.print(table)


def _longest_word(texts: Sequence[str]) -> int:
    return max(len(word) for text in texts for word in text.split() or [""])


def _between_names(path: str, room: int) -> str:
    """A path on as many lines as `room`, characters, asks for, each but the last ended by its "/"."""
    lines = [""]
    for part in re.findall(r"[^/]*/|[^/]+$", path):
        if lines[-1] and len(lines[-1]) + len(part) > room:
            lines.append("")
        lines[-1] += part
    return "\n".join(lines)


def _pipe_width() -> int:
    columns = os.environ.get("COLUMNS", "")
    return int(columns) if columns.isdecimal() and int(columns) > 0 else PIPE_WIDTH


def binding_facts(binding: Binding | None) -> dict[str, str]:
    """The binding of a sealed file, name -> text: number and date of resealings, and what it belongs to."""
    if binding is None:
        return {"bound to": "nothing: the file was made before sealed files stated what they belong to"}
    told = {"counter": str(binding.counter), "resealed": binding.date}
    axes = binding.of.get("axes")
    if not isinstance(axes, Mapping) or len(binding.of) != 1:
        of = json.dumps(binding.of, sort_keys=True, ensure_ascii=False) if binding.of else "nothing"
        return {**told, "bound to": of}
    return told | {f"bound to {name}": _bound(of) for name, of in sorted(axes.items())}


def _bound(of: Any) -> str:
    """What the tables of an axis belong to: its zero, its drive, and how many settings of the drive; all of it is in --json."""
    zero = _mapping(_mapping(of).get("zero"))
    drive = _mapping(zero.get("drive"))
    parts = [f"the zero of {zero['made']}" if zero.get("made") else ""]
    parts.append("the drive with " + ", ".join(f"{name} {value}" for name, value in drive.items()) if drive else "")
    settings = sum(len(_mapping(group)) for group in _mapping(_mapping(of).get("made_with")).values())
    parts.append(f"{settings} settings of the drive as they were" if settings else "")
    return ", ".join(part for part in parts if part) or "no zero and no drive"


def _mapping(value: Any) -> Mapping[str, Any]:
    """The value where it is a mapping; else an empty one: a file's header may hold anything."""
    return value if isinstance(value, Mapping) else {}


def print_facts(facts: Mapping[str, str]) -> None:
    """Aligned `name  value` lines on standard output."""
    width = max((len(name) for name in facts), default=0)
    for name, value in facts.items():
        print(f"{name:<{width}}  {value}")


def _plain(obj: object) -> object:
    if isinstance(obj, float):
        return obj if math.isfinite(obj) else None
    if isinstance(obj, Mapping):
        return {str(key): _plain(value) for key, value in obj.items()}
    if isinstance(obj, (list, tuple)):
        return [_plain(value) for value in obj]
    return obj
