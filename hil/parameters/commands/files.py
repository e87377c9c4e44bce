"""`hil params backup`, `diff` and `verify`: what drives hold, as files and against files. Reads only."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from drivers.errors import InputError
from hil.app.terminal.output import write_json
from hil.axis.axis_file import DriveAxis
from hil.parameters.commands.options import add_job, load_axes, sets_of, showing
from hil.parameters.commands.output import print_costs, print_parameters
from hil.parameters.compare import Comparison, Side
from hil.parameters.formats import FORMATS
from hil.parameters.job import back_up_axes, compare_axes
from hil.parameters.report import shown
from hil.parameters.snapshot import Backup

_MOST_ROWS = 60


def add_jobs(jobs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    backup = add_job(jobs, "backup", "read every parameter that can be put back, into a file", _backup)
    backup.add_argument(
        "--out", metavar="FILE", action="append", default=[], help="for each axis (default: <name>.params.toml)"
    )
    backup.add_argument("--format", choices=FORMATS, help="default: by the file's name, else toml")
    backup.add_argument("--all", action="store_true", dest="everything", help="also what is read only, to look at")
    for name, what, run in (
        ("diff", "what the drive holds differently from a set", _diff),
        ("verify", "whether the drive holds a set", _verify),
    ):
        parser = add_job(jobs, name, what, run, sets="the set to compare with")
        parser.add_argument(
            "--any-version", action="store_true", help="also a set read with another revision or firmware"
        )


# -- backup ------------------------------------------------------------------------------------------------------------
def _backup(args: argparse.Namespace) -> int:
    """0: every drive was read; 1: one was not."""
    axes = load_axes(args)
    paths = _outputs(args, axes)
    with showing() as progress:
        backups = back_up_axes(axes, paths, args.format, everything=args.everything, progress=progress)
    for axis, path, backup in zip(axes, paths, backups, strict=True):
        if backup.contents is None:
            print(f"{axis.name}: {backup.error}")
            continue
        print(f"{axis.name}: {len(backup.contents.entries)} parameters in {path}")
        for address, why in (backup.unreadable or {}).items():
            print(f"{axis.name}: {address} is left out: {why}")
    if args.json:
        write_json(args.json, {"drives": [_form(*each) for each in zip(paths, backups, strict=True)]})
    return 0 if all(backup.contents is not None for backup in backups) else 1


def _outputs(args: argparse.Namespace, axes: Sequence[DriveAxis]) -> list[Path]:
    if not args.out:
        suffix = args.format or "toml"
        return [axis.path.resolve().parent / f"{axis.name}.params.{suffix}" for axis in axes]
    if len(args.out) != len(axes):
        raise InputError(f"--out is given {len(args.out)} times, expected once for each of {len(axes)} axes")
    return [Path(path) for path in args.out]


def _form(path: Path, backup: Backup) -> dict[str, object]:
    contents = backup.contents
    return {
        "drive": backup.drive.name,
        "good": contents is not None,
        "error": backup.error,
        "file": str(path) if contents is not None else None,
        "parameters": len(contents.entries) if contents is not None else 0,
        "hash": contents.hash if contents is not None else None,
        "unreadable": backup.unreadable or {},
    }


# -- diff and verify ---------------------------------------------------------------------------------------------------
def _diff(args: argparse.Namespace) -> int:
    """0: compared, whatever came of it; 1: a drive did not answer."""
    comparisons = _compared(args)
    for comparison in comparisons:
        _print(comparison, costs=True)
    _write(args, comparisons)
    return 1 if any(comparison.error for comparison in comparisons) else 0


def _verify(args: argparse.Namespace) -> int:
    """0: every drive holds its set; 1: one does not, or did not answer."""
    comparisons = _compared(args)
    for comparison in comparisons:
        _print(comparison, costs=False)
    _write(args, comparisons)
    return 0 if all(comparison.same for comparison in comparisons) else 1


def _compared(args: argparse.Namespace) -> list[Comparison]:
    axes = load_axes(args)
    sets = sets_of(args, axes)
    with showing() as progress:
        return compare_axes(axes, sets, any_version=args.any_version, progress=progress)


def _write(args: argparse.Namespace, comparisons: Sequence[Comparison]) -> None:
    if args.json:
        good = all(each.same for each in comparisons)
        write_json(args.json, {"good": good, "drives": [each.as_json() for each in comparisons]})


def _print(comparison: Comparison, *, costs: bool) -> None:
    name = comparison.drive.name
    rows = [row for row in comparison.rows if row.side is not Side.SAME]
    same = len(comparison.rows) - len(rows)
    print(f"{name}: {same} of {len(comparison.contents.entries)} parameters as in the set, {len(rows)} not")
    if rows:
        cells = [
            [row.address, row.name, shown(row.held), shown(row.wanted), row.unit, row.why or row.side.value]
            for row in rows
        ]
        print_parameters("held", cells, _MOST_ROWS)
    for objection in comparison.objections:
        print(f"{name}: {objection}")
    if comparison.error:
        print(f"{name}: {comparison.error}")
    elif costs:
        print_costs(name, "a download", [comparison.cost], comparison.answer_s)
