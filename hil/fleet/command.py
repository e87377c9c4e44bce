"""`hil fleet`: many axes over years: index their campaigns, find what ages, compare and diagnose them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError
from drivers.files import replace_file
from hil.ui.terminal.output import Align, print_facts, print_table, write_json

if TYPE_CHECKING:  # an extra
    from hil.fleet.index import State

MOST_SHOWN = 25
"""Most lines of a table on the terminal; page and JSON have all."""
Progress = Callable[[int, int], None]


def _places(args: argparse.Namespace) -> tuple[Path, Path]:
    """The directory and its index. Raises InputError where the extra is missing."""
    if find_spec("pyarrow") is None:
        raise InputError("hil fleet needs the fleet extra: pip install 'hil[fleet]'")
    if getattr(args, "processes", None) is not None and args.processes < 1:
        raise InputError(f"--processes is {args.processes}, expected at least 1")
    root = Path(args.directory)
    return root, Path(args.index) if args.index else root / "fleet-index"


@contextmanager
def _progress(what: str) -> Iterator[Progress]:
    """A bar on a terminal, nothing else."""
    if not sys.stderr.isatty():
        yield lambda _done, _all: None
        return
    from rich.console import Console  # noqa: PLC0415  (slow to import)
    from rich.progress import Progress as Bar  # noqa: PLC0415

    with Bar(console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


# -- index -------------------------------------------------------------------------------------------------------------
def run_index(args: argparse.Namespace) -> int:
    root, index = _places(args)
    from hil.fleet.index import update  # noqa: PLC0415  (an extra, as below)

    with _progress("campaigns") as progress:
        found = update(
            root, index, scheduler=args.scheduler, processes=args.processes, again=args.again, progress=progress
        )
    print_facts(
        {
            "campaigns": f"{found.found}: {found.read} read, {found.kept} unchanged; {found.gone} gone since",
            "rows": str(found.rows),
            "not read": str(len(found.unread)),
            "index": str(index),
        }
    )
    for where, why in found.unread:
        print(f"  {where}: {why}")
    if args.json:
        unread = [{"campaign": where, "why": why} for where, why in found.unread]
        write_json(args.json, {**vars(found), "unread": unread, "index": str(index)})
    return 1 if found.unread else 0


def _read_state(index: Path) -> tuple[State, list[str]]:
    """The state of the index, with a warning where it is not complete, and what it could not read, one line each."""
    from hil.fleet.index import read_table, state_of  # noqa: PLC0415

    state = state_of(index)
    if not state.complete:
        print("hil: the index is not complete: its last run was ended, hil fleet index goes on", file=sys.stderr)
    table = read_table(index, "campaigns", ("campaign", "why"))
    unread = [f"{one['campaign']}: {one['why']}" for one in table.to_pylist() if one["why"]]
    unread += [f"{where}: {why}" for where, why in state.unread]
    if unread:
        print(f"hil: not read: {len(unread)} campaigns or passes; hil fleet index lists them", file=sys.stderr)
    return state, sorted(unread)


def _under(state: State) -> str:
    return f"{state.of} · {datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"


def _write_page(args: argparse.Namespace, text: str) -> None:
    replace_file(args.out, text.encode())
    print(args.out)


def _heads(names: Sequence[str]) -> list[str | tuple[str, Align]]:
    words = {"what", "of", "pass", "begun", "cause", "action", "left"}
    return [(name, "left") if name in words else name for name in names]


# -- trend, compare, diagnose ------------------------------------------------------------------------------------------
def run_trend(args: argparse.Namespace) -> int:
    _, index = _places(args)
    from hil.fleet.ageing import series_of, trends  # noqa: PLC0415
    from hil.fleet.index import read_table  # noqa: PLC0415
    from hil.fleet.values import AGEING  # noqa: PLC0415
    from hil.fleet.words import MEMORY, TREND_HEAD, trend_json, trend_row  # noqa: PLC0415

    state, unread = _read_state(index)
    rows = read_table(index, "results").to_pylist()
    found = trends(series_of(rows, args.quantity or AGEING, _since(args.since)), args.false_alarms)
    shown = found.aged if args.all else found.aged[: max(MOST_SHOWN, len(found.alarms))]
    if shown:
        print_table(_heads(TREND_HEAD), map(trend_row, shown))
    print(f"{len(found.alarms)} alarms in {len(found.aged)} series of three values or more")
    if found.aged:
        print(found.stated())
    if found.remembers:
        print(MEMORY.format(found.memory, 2.0 * found.memory_std))
    if found.short:
        print(f"not watched: {len(found.short)} series of fewer than three values")
    if args.out:
        from hil.fleet.report import render_trend  # noqa: PLC0415  (plots are slow to import)

        _write_page(args, render_trend(found, _under(state), unread))
    if args.json:
        write_json(args.json, {"complete": state.complete, **trend_json(found), "not_read": unread})
    return 1 if found.alarms else 0


def _since(text: str | None) -> datetime | None:
    if text is None:
        return None
    try:
        date = datetime.fromisoformat(text)
    except ValueError as error:
        raise InputError(f"--since is {text!r}, expected a date such as 2026-01-31") from error
    return date.astimezone(UTC)


def run_compare(args: argparse.Namespace) -> int:
    _, index = _places(args)
    from hil.fleet.ageing import compare, series_of  # noqa: PLC0415
    from hil.fleet.index import read_table  # noqa: PLC0415
    from hil.fleet.values import AGEING, QUANTITIES  # noqa: PLC0415
    from hil.fleet.words import compare_head, compare_json, compare_row, compare_rule  # noqa: PLC0415

    state, unread = _read_state(index)
    rows = read_table(index, "results").to_pylist()
    found = compare(series_of(rows, args.quantity or AGEING))
    for one in found:
        shown = [compare_row(each, one) for each in one.axes[: max(MOST_SHOWN, sum(a.unlike for a in one.axes))]]
        print_table(_heads(compare_head(one)), shown, title=QUANTITIES[one.quantity].title)
        print(compare_rule(one))
    if not found:
        print("no axis has a value of what is compared")
    if args.out:
        from hil.fleet.report import render_compare  # noqa: PLC0415  (plots are slow to import)

        _write_page(args, render_compare(found, _under(state), unread))
    if args.json:
        compared = [compare_json(one) for one in found]
        write_json(args.json, {"complete": state.complete, "compared": compared, "not_read": unread})
    return 1 if any(each.unlike for one in found for each in one.axes) else 0


def run_diagnose(args: argparse.Namespace) -> int:
    root, index = _places(args)
    from hil.fleet.causes import counted, diagnose_all, newest_passes  # noqa: PLC0415
    from hil.fleet.index import read_table  # noqa: PLC0415
    from hil.fleet.words import cause_json, causes_head, causes_row  # noqa: PLC0415

    state, unread = _read_state(index)
    campaigns = read_table(index, "campaigns", ("campaign", "signature")).to_pylist()
    tasks = newest_passes(root, campaigns, read_table(index, "results").to_pylist())
    if args.axis:
        missing = set(args.axis) - {task.axis for task in tasks}
        if missing:
            raise InputError(f"no pass of axis {sorted(missing)[0]} has figures of a positioning test")
        tasks = [task for task in tasks if task.axis in args.axis]
    with _progress("axes") as progress:
        causes = diagnose_all(index, tasks, scheduler=args.scheduler, processes=args.processes, progress=progress)
    if causes:
        print_table(_heads(causes_head()), map(causes_row, causes[:MOST_SHOWN]))
    for effect, count in counted(causes).items():
        print(f"{effect}: on {count} of {len(tasks)} axes")
    if args.out:
        from hil.fleet.report import render_causes  # noqa: PLC0415  (plots are slow to import)

        _write_page(args, render_causes(causes, _under(state), unread))
    if args.json:
        forms = [cause_json(one) for one in causes]
        write_json(args.json, {"complete": state.complete, "causes": forms, "axes": len(tasks), "not_read": unread})
    return 0
