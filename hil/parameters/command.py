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
from hil.parameters.report import Ending, JobReport, Row, Verdict, shown, slow
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


# -- backup, diff and verify -------------------------------------------------------------------------------------------
_MOST_DIFFERENCES = 60


# -- backup ------------------------------------------------------------------------------------------------------------
def backup(args: argparse.Namespace) -> int:
    """Exit status 0: every drive was read; 1: one was not."""
    axes = load_axes(args)
    paths = _outputs(args, axes)
    with progress_bars() as progress:
        backups = back_up_axes(axes, paths, args.format, everything=args.everything, progress=progress)
    for axis, path, backup in zip(axes, paths, backups, strict=True):
        if backup.contents is None:
            print(f"{axis.name}: {backup.error}")
            continue
        print(f"{axis.name}: {len(backup.contents.entries)} parameters in {path}")
        for note in backup.notes:
            print(f"{axis.name}: {note}")
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
    comparisons = _compared(args)
    for comparison in comparisons:
        _print_comparison(comparison, costs=True)
    _write_json(args, comparisons)
    return 1 if any(comparison.error for comparison in comparisons) else 0


def verify(args: argparse.Namespace) -> int:
    """Exit status 0: every drive holds its set; 1: one does not, or did not answer."""
    comparisons = _compared(args)
    for comparison in comparisons:
        _print_comparison(comparison, costs=False)
    _write_json(args, comparisons)
    return 0 if all(comparison.same for comparison in comparisons) else 1


def _compared(args: argparse.Namespace) -> list[Comparison]:
    axes = load_axes(args)
    sets = sets_of(args, axes)
    with progress_bars() as progress:
        return compare_axes(axes, sets, any_version=args.any_version, progress=progress)


def _write_json(args: argparse.Namespace, comparisons: Sequence[Comparison]) -> None:
    if args.json:
        good = all(each.same for each in comparisons)
        write_json(args.json, {"good": good, "drives": [each.as_json() for each in comparisons]})


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
    for objection in comparison.objections:
        print(f"{name}: {objection}")
    for note in comparison.notes:
        print(f"{name}: {note}")
    if comparison.error:
        print(f"{name}: {comparison.error}")
    elif costs:
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
            print(f"{drive.name}: would read {len(wanted)} parameters, write those that differ, and read these back")
            for note in (*notes[-1], *notes_of_file(drive)):
                print(f"{drive.name}: {note}")
            for objection in against:
                print(f"{drive.name}: would be refused: {objection}")
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
        for address, why in (backup.unreadable or {}).items():
            print(f"{axis.name}: {address} is not in the backup: {why}")
    return all(backup.contents is not None for backup in backups)


def _agreed(axes: Sequence[DriveAxis]) -> bool:
    """Ask the person at the terminal. Raises InputError where nobody answers."""
    try:
        answer = input(f"load the maker's defaults into {', '.join(axis.name for axis in axes)}? [y/N] ")
    except (EOFError, OSError) as error:
        raise InputError("nobody answered, nothing was loaded: expected y, or --yes") from error
    return answer.strip().lower() in ("y", "yes")


# -- resume and rollback -----------------------------------------------------------------------------------------------
def resume(args: argparse.Namespace) -> int:
    """Finish a download that was cut off. Exit status as of `_recover`."""
    return _recover(args, forward=True)


def rollback(args: argparse.Namespace) -> int:
    """Take back a download that was cut off. Exit status as of `_recover`."""
    return _recover(args, forward=False)


def _recover(args: argparse.Namespace, *, forward: bool) -> int:
    """Exit status 0: finished, or nothing to finish; 1: still unfinished."""
    with progress_bars() as progress:
        reports = recover_axes(load_axes(args), forward=forward, progress=progress)
    if not reports:
        print("nothing to do: no download was cut off")
        if args.json:
            write_json(args.json, {"good": True, "drives": []})
        return 0
    return print_reports(reports, args.json)


# -- output ------------------------------------------------------------------------------------------------------------
_MOST_ROWS = 40  # of parameters, in the table of a report


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
    counts = {verdict: sum(row.verdict is verdict for row in report.rows) for verdict in Verdict}
    told = ", ".join(f"{count} {verdict.value}" for verdict, count in counts.items() if count)
    print(f"{report.drive}: {report.ending.value}" + (f" ({told}; {report.seconds:.3f} s)" if told else ""))
    refused = report.ending is Ending.REFUSED  # then the reasons matter
    changed = [row for row in report.rows if row.verdict is not Verdict.SAME and not refused]
    if changed:
        print_parameters("before", [_cells(row) for row in changed], _MOST_ROWS)
    for objection in report.objections:
        print(f"{report.drive}: {objection}")
    for line in (report.error, *report.notes):
        if line:
            print(f"{report.drive}: {line}")
    if report.kept:
        print(f"{report.drive}: {report.kept}")
    if report.journal:
        print(
            f"{report.drive}: `hil params resume` finishes it, `hil params rollback` takes it back ({report.journal})"
        )
    _print_slow(report)


def _cells(row: Row) -> list[str]:
    return [row.address, row.name, shown(row.old), shown(row.new), row.unit, row.verdict.value]


def _print_slow(report: JobReport) -> None:
    for row in slow(report.rows)[:5]:
        times = [f"{kind} {1e3 * time:.1f} ms" for kind, time in (("read", row.read_s), ("write", row.write_s)) if time]
        print(f"{report.drive}: slow: {row.address} {row.name}, {', '.join(times)}")


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
