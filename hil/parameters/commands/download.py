"""`hil params download`, `store` and `restore`: what changes drives."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from drivers.errors import InputError
from hil.app.terminal.output import write_json
from hil.axis.axis_file import DriveAxis
from hil.parameters.commands.options import add_job, load_axes, sets_of, showing, tell_person
from hil.parameters.commands.output import print_costs, print_reports
from hil.parameters.defaults import load_defaults
from hil.parameters.job import compare_axes, set_before_last, set_of_last, write_axes
from hil.parameters.predict import Prediction, predict
from hil.parameters.preflight import Objection, match_set
from hil.parameters.report import Ending, JobReport
from hil.parameters.set_file import ParameterSet
from hil.parameters.wiring import connected_parameters, unconnected_parameters


def add_jobs(jobs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = add_job(jobs, "download", "write a set to the drive: all or nothing, read back", _download, sets="the set")
    parser.add_argument(
        "--dry-run", action="store_true", help="look at the set and the drive's file only, and predict; nothing is sent"
    )
    store = add_job(
        jobs, "store", "have the drive keep what it was last told", _store, sets="what it must hold for that"
    )
    restore = add_job(jobs, "restore", "as before the last download, or as a backup has it", _restore, sets="a backup")
    restore.add_argument("--factory", action="store_true", help="the maker's defaults instead (1011h), and a restart")
    for job in (parser, restore):
        job.add_argument("--store", action="store_true", help="have the drive keep it, after all of it was proven")
    for job in (parser, store, restore):
        job.add_argument(
            "--audit", action="store_true", help="after storing, start the drive anew and read all of it again"
        )
        job.add_argument("--any-version", action="store_true", help="also a set read with another revision or firmware")


def _download(args: argparse.Namespace) -> int:
    """0: every drive holds its set; 1: they were refused, put back, or are unfinished."""
    axes = load_axes(args)
    sets = sets_of(args, axes)
    if args.dry_run:
        return _dry_run(args, axes, sets)
    return _write(args, axes, sets, store=args.store)


def _write(args: argparse.Namespace, axes: Sequence[DriveAxis], sets: Sequence[ParameterSet], *, store: bool) -> int:
    if args.audit and not store:
        raise InputError("--audit needs --store: what is not kept is gone after a restart")
    ask = tell_person if args.audit else None
    with showing() as progress:
        reports = write_axes(axes, sets, store=store, ask=ask, any_version=args.any_version, progress=progress)
    return print_reports(reports, args.json)


def _dry_run(args: argparse.Namespace, axes: Sequence[DriveAxis], sets: Sequence[ParameterSet]) -> int:
    predictions: list[Prediction] = []
    objections: list[list[Objection]] = []
    with unconnected_parameters(axes) as drives:
        for drive, contents in zip(drives, sets, strict=True):
            wanted, against = match_set(drive, contents)
            predictions.append(predict(drive, wanted))
            objections.append(against)
            print(
                f"{drive.name}: would look at {len(wanted)} parameters and write those that differ, then read them back"
            )
            for objection in against:
                print(f"{drive.name}: would be refused: {objection}")
    for prediction in predictions:
        print_costs(prediction.drive, "looking", [prediction.look])
        print_costs(prediction.drive, "writing all and reading back", [prediction.write])
    if len(predictions) > 1:
        print_costs("together", "all of it", [prediction.whole for prediction in predictions])
    if args.store:
        print("would have the drives keep it")
    if args.json:
        forms = [
            {**prediction.as_json(), "objections": [vars(each) for each in against]}
            for prediction, against in zip(predictions, objections, strict=True)
        ]
        write_json(args.json, {"good": not any(objections), "drives": forms})
    return 1 if any(objections) else 0


# -- store -------------------------------------------------------------------------------------------------------------
def _store(args: argparse.Namespace) -> int:
    """0: every drive held its set and stored it; 1: one does not hold it, or did not store."""
    axes = load_axes(args)
    sets = sets_of(args, axes) if args.sets else [set_of_last(axis) for axis in axes]
    with showing() as progress:
        compared = compare_axes(axes, sets, any_version=args.any_version, progress=progress)
    differing = [each for each in compared if not each.same]
    for each in differing:
        why = each.error or "; ".join(str(objection) for objection in each.objections) or "it holds other values"
        print(f"{each.drive.name}: not stored, as it does not hold {each.contents.name}: {why} (`hil params diff`)")
    if differing:
        if args.json:
            write_json(args.json, {"good": False, "drives": [each.as_json() for each in compared]})
        return 1
    return _write(args, axes, sets, store=True)


# -- restore -----------------------------------------------------------------------------------------------------------
def _restore(args: argparse.Namespace) -> int:
    """0: every drive holds what it held before; 1: they were refused, put back, or are unfinished."""
    axes = load_axes(args)
    if args.factory:
        return _factory(args, axes)
    sets = sets_of(args, axes) if args.sets else [set_before_last(axis) for axis in axes]
    return _write(args, axes, sets, store=args.store)


def _factory(args: argparse.Namespace, axes: Sequence[DriveAxis]) -> int:
    if args.sets or args.store or args.audit:
        raise InputError("--factory stands alone: the drive takes its defaults itself, and keeps them")
    with connected_parameters(axes) as drives:
        errors = load_defaults(drives, tell_person)
    reports = [
        JobReport(drive.name, Ending.UNFINISHED if error else Ending.WRITTEN, error=error)
        for drive, error in zip(drives, errors, strict=True)
    ]
    for report in reports:
        print(f"{report.drive}: {report.error or 'holds its factory defaults, and was started anew'}")
    if args.json:
        write_json(args.json, {"good": not any(errors), "drives": [report.as_json() for report in reports]})
    return 1 if any(errors) else 0
