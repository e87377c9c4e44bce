"""The jobs of `hil params`: backup, diff and verify read; download, store and restore write; resume and rollback recover."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from drivers.errors import InputError
from drivers.raw_parameters import WireTime
from hil.axis.axis_file import DriveAxis, load_drive_axis
from hil.machine.events import Event
from hil.parameters.compare import Comparison, Side
from hil.parameters.job import (
    back_up_axes,
    compare_axes,
    load_set,
    new_backup_path,
    recover_axes,
    set_before_last,
    set_of_last,
    write_axes,
)
from hil.parameters.preflight import (
    Objection,
    Prediction,
    left_out,
    match_set,
    notes_of_file,
    predict,
    seconds_together,
)
from hil.parameters.report import Ending, JobReport, ParameterVerdict, shown, slow
from hil.parameters.restart import load_defaults
from hil.parameters.set_file import ParameterSet
from hil.parameters.snapshot import Backup
from hil.parameters.tasks import Progress
from hil.parameters.wiring import connected_parameters, unconnected_parameters
from hil.ui.terminal.axis_options import tell_bench
from hil.ui.terminal.output import Align, print_table, times, write_json
from hil.ui.terminal.progress import terminal_progress


# -- what the jobs share -----------------------------------------------------------------------------------------------
def load_axes(args: argparse.Namespace) -> list[DriveAxis]:
    """The axis files of a command line."""
    return [load_drive_axis(path) for path in args.axes]


def sets_of(args: argparse.Namespace, axes: Sequence[DriveAxis]) -> list[ParameterSet]:
    """The set of each axis. Raises InputError unless `--set` is given once or once for each axis, SealedError for a wrong
    signature."""
    if not args.sets:
        raise InputError("--set FILE is missing, expected the set to work with")
    if len(args.sets) not in (1, len(axes)):
        raise InputError(f"--set is given {times(len(args.sets))}, expected once, or once for each axis ({len(axes)})")
    paths = args.sets * len(axes) if len(args.sets) == 1 else args.sets
    return [
        load_set(path, axis, signed=args.signed, pdos=not args.without_pdos)
        for path, axis in zip(paths, axes, strict=True)
    ]


def ask_person(what: str) -> None:
    """Ask the person at the machine to do something, on stderr."""
    print(f"hil: {what}", file=sys.stderr, flush=True)


@contextmanager
def progress_bars() -> Iterator[Progress]:
    """A progress bar for each stage and drive, on a terminal."""
    with terminal_progress() as listener:

        def show(stage: str, drive: str, done: int, total: int) -> None:
            listener(Event(f"{stage}, {drive}", "", done, total))

        yield show


def tell(who: str, *lines: object) -> None:
    """Print each line that is not empty, with the axis or drive that it is of."""
    for line in filter(None, lines):
        print(f"{who}: {line}")


# -- backup ------------------------------------------------------------------------------------------------------------
def backup(args: argparse.Namespace) -> int:
    """Exit status 0: every drive was read; 1: one was not."""
    axes = load_axes(args)
    paths = _outputs(args, axes)
    with progress_bars() as progress:
        backups = back_up_axes(axes, paths, args.format, everything=args.everything, progress=progress)
    for axis, path, backup in zip(axes, paths, backups, strict=True):
        if backup.contents is None:
            tell(axis.name, backup.error)
            continue
        left_out_of_it = (f"{address} is left out: {why}" for address, why in (backup.unreadable or {}).items())
        tell(axis.name, f"{len(backup.contents.entries)} parameters in {path}", *backup.notes, *left_out_of_it)
    if args.json:
        write_json(args.json, {"drives": [_form(*each) for each in zip(paths, backups, strict=True)]})
    return 0 if all(backup.contents is not None for backup in backups) else 1


def _outputs(args: argparse.Namespace, axes: Sequence[DriveAxis]) -> list[Path]:
    if not args.out:
        suffix = args.format or "toml"
        return [axis.path.resolve().parent / f"{axis.name}.params.{suffix}" for axis in axes]
    if len(args.out) != len(axes):
        raise InputError(f"--out is given {times(len(args.out))}, expected once for each axis ({len(axes)})")
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
        "notes": list(backup.notes),
    }


# -- diff and verify ---------------------------------------------------------------------------------------------------
def diff(args: argparse.Namespace) -> int:
    """Exit status 0: compared, with or without differences; 1: a drive did not answer."""
    return 1 if any(comparison.error for comparison in _compared(args, costs=True)) else 0


def verify(args: argparse.Namespace) -> int:
    """Exit status 0: every drive holds its set; 1: one does not, or did not answer."""
    return 0 if all(comparison.same for comparison in _compared(args, costs=False)) else 1


def _compared(args: argparse.Namespace, *, costs: bool) -> list[Comparison]:
    """The comparisons, printed and written. costs: also how long a download would take."""
    axes = load_axes(args)
    sets = sets_of(args, axes)
    with progress_bars() as progress:
        found = compare_axes(axes, sets, any_version=args.any_version, progress=progress)
    for comparison in found:
        _print_comparison(comparison, costs=costs)
    if args.json:
        good = all(each.same for each in found)
        write_json(args.json, {"good": good, "drives": [each.as_json() for each in found]})
    return found


def _print_comparison(comparison: Comparison, *, costs: bool) -> None:
    name = comparison.drive.name
    rows = [row for row in comparison.rows if row.side is not Side.SAME]
    same = len(comparison.rows) - len(rows)
    print(f"{name}: as in the set: {same} of {len(comparison.contents.entries)} parameters; different: {len(rows)}")
    if rows:
        cells = [
            [row.address, row.name, shown(row.held), shown(row.wanted), row.unit, row.why or row.side.value]
            for row in rows
        ]
        print_parameters("held", cells, _MOST_DIFFERENCES)
    tell(name, *comparison.objections, *comparison.notes, comparison.error)
    if costs and not comparison.error:
        print_costs(name, "a download", [comparison.cost], comparison.answer_s)


# -- download, store and restore ---------------------------------------------------------------------------------------
def download(args: argparse.Namespace) -> int:
    """Exit status 0: every drive holds its set; 1: they were refused, put back, or are unfinished."""
    axes = load_axes(args)
    sets = sets_of(args, axes)
    if args.dry_run:
        return _dry_run(args, axes, sets)
    return _write_sets(args, axes, sets, store=args.store)


def _write_sets(
    args: argparse.Namespace, axes: Sequence[DriveAxis], sets: Sequence[ParameterSet], *, store: bool
) -> int:
    if args.audit and not store:
        raise InputError("--audit needs --store: values that are not stored are lost at a restart")
    ask = ask_person if args.audit else None
    with progress_bars() as progress:
        reports = write_axes(
            axes,
            sets,
            store=store,
            ask=ask,
            any_version=args.any_version,
            other_eds=getattr(args, "other_eds", False),
            progress=progress,
        )
    status = print_reports(reports, args.json)
    if any(report.ending not in (Ending.UNCHANGED, Ending.REFUSED) for report in reports):
        for axis in axes:
            tell_bench(axis)
    return status


def _dry_run(args: argparse.Namespace, axes: Sequence[DriveAxis], sets: Sequence[ParameterSet]) -> int:
    predictions: list[Prediction] = []
    objections: list[list[Objection]] = []
    notes: list[list[str]] = []
    with unconnected_parameters(axes) as drives:
        for drive, contents in zip(drives, sets, strict=True):
            wanted, against = match_set(drive, contents)
            predictions.append(predict(drive, wanted))
            objections.append(against)
            omitted = left_out(drive, contents)
            notes.append([omitted] if omitted else [])
            told = f"would read {len(wanted)} parameters, write those that differ, and read these back"
            refused = (f"would be refused: {objection}" for objection in against)
            tell(drive.name, told, *notes[-1], *notes_of_file(drive), *refused)
    for prediction in predictions:
        print_costs(prediction.drive, "reading", [prediction.look])
        print_costs(prediction.drive, "writing all of them and reading them back", [prediction.write])
    if len(predictions) > 1:
        print_costs("together", "all of it", [prediction.whole for prediction in predictions])
    if args.store:
        print("would have the drives keep it")
    if args.json:
        forms = [
            {**prediction.as_json(), "objections": [vars(each) for each in against], "notes": told}
            for prediction, against, told in zip(predictions, objections, notes, strict=True)
        ]
        write_json(args.json, {"good": not any(objections), "drives": forms})
    return 1 if any(objections) else 0


# -- store -------------------------------------------------------------------------------------------------------------
def store(args: argparse.Namespace) -> int:
    """Exit status 0: every drive held its set and stored it; 1: one does not hold it, or did not store."""
    axes = load_axes(args)
    sets = sets_of(args, axes) if args.sets else [set_of_last(axis) for axis in axes]
    with progress_bars() as progress:
        compared = compare_axes(axes, sets, any_version=args.any_version, progress=progress)
    differing = [each for each in compared if not each.same]
    for each in differing:
        why = each.error or "; ".join(str(objection) for objection in each.objections) or "other values"
        print(
            f"{each.drive.name}: not stored, as the drive does not hold the set '{each.contents.name}': {why} (`hil params diff`)"
        )
    if differing:
        if args.json:
            write_json(args.json, {"good": False, "drives": [each.as_json() for each in compared]})
        return 1
    return _write_sets(args, axes, sets, store=True)


# -- restore -----------------------------------------------------------------------------------------------------------
def restore(args: argparse.Namespace) -> int:
    """Exit status 0: every drive holds the earlier values; 1: they were refused, put back, or are unfinished."""
    axes = load_axes(args)
    if args.factory:
        return _factory(args, axes)
    sets = sets_of(args, axes) if args.sets else [set_before_last(axis) for axis in axes]
    return _write_sets(args, axes, sets, store=args.store)


def _factory(args: argparse.Namespace, axes: Sequence[DriveAxis]) -> int:
    """Exit status 0: every drive holds its defaults; 1: one was not read before or did not load them, or nobody agreed."""
    if args.sets or args.store or args.audit:
        raise InputError("--factory goes with no other option: the drive loads its defaults itself, and stores them")
    if not (_backed_up(axes) and (args.yes or _agreed(axes))):
        print("nothing was loaded")
        return 1
    with connected_parameters(axes) as drives:
        errors = load_defaults(drives, ask_person)
    reports = [
        JobReport(drive.name, Ending.UNFINISHED if error else Ending.WRITTEN, error=error)
        for drive, error in zip(drives, errors, strict=True)
    ]
    for report in reports:
        print(f"{report.drive}: {report.error or 'holds its factory defaults, and was restarted'}")
    for axis in axes:
        tell_bench(axis)
    if args.json:
        write_json(args.json, {"good": not any(errors), "drives": [report.as_json() for report in reports]})
    return 1 if any(errors) else 0


def _backed_up(axes: Sequence[DriveAxis]) -> bool:
    """Back up every drive before its defaults are loaded, and say what they take the place of; whether all could be read."""
    paths = [new_backup_path(axis) for axis in axes]
    with progress_bars() as progress:
        backups = back_up_axes(axes, paths, progress=progress)
    for axis, path, backup in zip(axes, paths, backups, strict=True):
        if backup.contents is None:
            print(f"{axis.name}: no backup: {backup.error}")
            continue
        print(
            f"{axis.name}: the maker's defaults take the place of all {len(backup.contents.entries)} parameters, also of motor, units,"
            f" limits, tuning and homing, and hold after a restart; backup: {path}"
            f" (hil params restore {axis.path} --set {path} --store)"
        )
        tell(
            axis.name, *(f"{address} is not in the backup: {why}" for address, why in (backup.unreadable or {}).items())
        )
    return all(backup.contents is not None for backup in backups)


def _agreed(axes: Sequence[DriveAxis]) -> bool:
    """Ask the person at the terminal. Raises InputError where nobody answers."""
    try:
        answer = input(f"load the maker's defaults into {', '.join(axis.name for axis in axes)}? [y/N] ")
    except (EOFError, OSError) as error:
        raise InputError("nobody answered, nothing was loaded: expected y, or --yes") from error
    return answer.strip().lower() in ("y", "yes")


# -- resume and rollback -----------------------------------------------------------------------------------------------
def recover(args: argparse.Namespace) -> int:
    """Finish a download that was cut off, or take it back. Exit status 0: done, or nothing to do; 1: still unfinished."""
    with progress_bars() as progress:
        reports = recover_axes(load_axes(args), forward=args.forward, progress=progress)
    if not reports:
        print("nothing to do: no download was cut off")
        if args.json:
            write_json(args.json, {"good": True, "drives": []})
        return 0
    return print_reports(reports, args.json)


# -- output ------------------------------------------------------------------------------------------------------------
_MOST_ROWS, _MOST_DIFFERENCES = 40, 60  # of parameters, in the table of a report and of a comparison


def print_reports(reports: Sequence[JobReport], json: str | None) -> int:
    """Print the reports and write them to the JSON file; returns the exit status."""
    for report in reports:
        _print_report(report)
    if json:
        write_json(json, {"good": all(each.good for each in reports), "drives": [each.as_json() for each in reports]})
    return 0 if all(each.good for each in reports) else 1


def print_parameters(held: str, rows: Sequence[Sequence[str]], most: int) -> None:
    """A table of parameters: value held, value of the set, outcome; at most `most` rows. held: head of that column."""
    columns: list[str | tuple[str, Align]] = ["address", ("name", "left"), held, "set", ("unit", "left"), ("", "left")]
    print_table(columns, rows[:most])
    if len(rows) > most:
        print(f"… and {len(rows) - most} more (--json FILE has all)")


def _print_report(report: JobReport) -> None:
    counts = {verdict: sum(row.verdict is verdict for row in report.rows) for verdict in ParameterVerdict}
    told = ", ".join(f"{count} {verdict.value}" for verdict, count in counts.items() if count)
    print(f"{report.drive}: {report.ending.value}" + (f" ({told}; {report.seconds:.3f} s)" if told else ""))
    refused = report.ending is Ending.REFUSED  # then the reasons matter
    changed = [row for row in report.rows if row.verdict is not ParameterVerdict.SAME and not refused]
    if changed:
        cells = [
            [row.address, row.name, shown(row.old), shown(row.new), row.unit, row.verdict.value] for row in changed
        ]
        print_parameters("before", cells, _MOST_ROWS)
    ways = f"`hil params resume` finishes it, `hil params rollback` takes it back ({report.journal})"
    tell(report.drive, *report.objections, report.error, *report.notes, report.kept, ways if report.journal else "")
    for row in slow(report.rows)[:5]:
        times = [f"{kind} {1e3 * time:.1f} ms" for kind, time in (("read", row.read_s), ("write", row.write_s)) if time]
        tell(report.drive, f"slow: {row.address} {row.name}, {', '.join(times)}")


def print_costs(who: str, what: str, costs: Sequence[WireTime], answer_s: float = 0.0) -> None:
    """Print the duration of accesses. answer_s: the drive's own time for one answer, s."""
    print(
        f"{who}: {what} takes at most {1e3 * seconds_together(costs, answer_s):.1f} ms on the bus"
        + (
            f", with {1e3 * answer_s:.2f} ms that the drive takes for each answer"
            if answer_s
            else ", and the time that the drives take to answer"
        )
    )
