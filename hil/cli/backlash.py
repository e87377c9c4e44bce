"""`hil backlash`: system B, lost motion from the servo's torque."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from drivers.drive import ServoDrive
from hil.axis import DriveAxis, load_drive_axis
from hil.axis_backlash import METHODS, BacklashConfig, default_backlash
from hil.backlash_settings import TABLE, backlash_settings
from hil.cli.axis_options import add_axis_arguments, drive_in_words
from hil.cli.output import number, print_facts, print_table, write_json
from hil.cli.progress import terminal_progress
from hil.files import replace_file
from hil.procedures.neutral_settings import BacklashSettings, restore
from hil.procedures.torque_backlash import DIRECTIONS, TorqueBacklash, check_drive, measure_backlash
from hil.wind_up.result import NAMES, fitted_lost_motion, mean_um, reversal_json
from hil.wind_up.trace import ReversalTrace
from hil.wiring import connected_drive

EXAMPLE = """\
example:
  hil backlash X.toml --dry-run                     what would move, how far, and which parameters
  hil backlash X.toml --report backlash.html        measure both reversals; the drive's parameters are as before afterwards
  hil backlash X.toml --runs 5 --write              mean of five, written to the drive's backlash parameter and read back
  hil backlash X.toml --restore                     put back what an interrupted measurement could not

The [backlash] section of the axis file says where, in which steps, and which parameters (hil/examples/backlash_axis.toml). No position
sensor is needed: the motor's torque shows when the table breaks away. Every reading is kept in the axis's folder, also of what was
interrupted. Exit status 1: no break-away within the allowed steps (detection limit exceeded); everything was put back.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "backlash",
        help="lost motion from the servo's torque, without a position sensor",
        description="Reverse, step until the table breaks away, and read the lost motion from the motor's torque, both ways.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_axis_arguments(parser)
    parser.add_argument("--runs", type=_count, help="how often both ways (default: the axis file's)")
    parser.add_argument("--method", choices=METHODS, help="which estimate counts (default: the axis file's)")
    parser.add_argument(
        "--write", action="store_true", help="write the mean to the backlash parameter, and read it back"
    )
    parser.add_argument(
        "--restore", action="store_true", help="measure nothing; put back what an earlier run left changed"
    )
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    parser.set_defaults(run=run)


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and 0 < int(text) <= 100):
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a whole number, 1 to 100")
    return int(text)


def run(args: argparse.Namespace) -> int:
    """0: measured; 1: detection limit exceeded."""
    axis = load_drive_axis(args.axis)
    how = axis.backlash or default_backlash(axis.path, axis.limits, axis.scaling, axis.drive.backend)
    given = {"runs": args.runs, "method": args.method}
    how = replace(how, **{name: value for name, value in given.items() if value is not None})
    if args.dry_run:
        _print_plan(axis, how, args)
        return 0
    with connected_drive(axis) as drive:
        settings = backlash_settings(axis, how, drive)
        if args.restore:
            return _restore(settings)
        result, kept = _measure(axis, how, drive, settings, args.write)
    facts = _facts(settings, result)
    _print(result, facts, kept)
    if args.report:
        _write_report(args.report, axis, how, result, facts)
    if args.json:
        write_json(args.json, _form(axis, how, settings, result))
    return 0 if result.lost_motion_um is not None else 1


def _measure(
    axis: DriveAxis, how: BacklashConfig, drive: ServoDrive, settings: BacklashSettings, write: bool
) -> tuple[TorqueBacklash, Path]:
    check_drive(drive, how)
    kept = _next_file(axis.store.directory)
    with terminal_progress() as listener:
        result = measure_backlash(drive, how, settings, write=write, keep=_keeper(kept), listener=listener, tell=_say)
    return result, kept


def _say(text: str) -> None:
    print(f"hil: {' '.join(text.split())}", file=sys.stderr)


def _next_file(directory: Path) -> Path:
    taken = [int(path.stem.rpartition("-")[2]) for path in directory.glob("backlash-[0-9]*.jsonl")]
    return directory / f"backlash-{max(taken, default=0) + 1:03d}.jsonl"


def _keeper(path: Path) -> Callable[[int, ReversalTrace], None]:
    """One line of JSON for every reversal, whole or broken off."""

    def keep(run: int, trace: ReversalTrace) -> None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"run": run, **trace.to_json()}) + "\n")

    return keep


def _restore(settings: BacklashSettings) -> int:
    found = restore(settings)
    if found is None:
        print("nothing to put back: the last measurement left everything as it was")
    else:
        print("put back: " + ", ".join(f"{name} = {value:g}" for name, value in found.values.items()))
    return 0


def _print_plan(axis: DriveAxis, how: BacklashConfig, args: argparse.Namespace) -> None:
    if args.restore:
        print(f"axis {axis.name} over {axis.drive.backend}: would write back what an earlier measurement noted, if any")
        return
    print(
        f"axis {axis.name} over {axis.drive.backend}: would enable it{', home it' if how.home else ''} and, {how.runs} times:"
    )
    for direction in DIRECTIONS:
        print(
            f"  {NAMES[direction]}: from {how.start_mm(direction):g} mm to {how.turning_mm(direction):g} mm, turn back, and go in"
            f" steps of {how.step_um:g} µm, to {how.end_mm(direction):g} mm at most"
        )
    if how.parameter is None:
        print(f"  no parameter of the drive is touched; the amount is kept in {axis.store.directory / TABLE}")
    else:
        names = [name for name in (how.parameter, how.acceleration) if name]
        print(f"  meanwhile {' and '.join(names)} would be 0, and as before afterwards")
    print(f"  the mean would {'take the place of the amount' if args.write else 'not be written'}")


def _facts(settings: BacklashSettings, result: TorqueBacklash) -> dict[str, str]:
    """The parameters before and now."""
    before = result.found.values
    facts = {f"{name}, before": f"{value:g}" for name, value in before.items()}
    facts[f"1 of {settings.amount.name}"] = f"{settings.amount_um:g} µm"
    if result.written is None:
        facts["now"] = "as before, nothing was written"
    else:
        facts[f"{settings.amount.name}, written and read back"] = f"{result.written:g}"
    if result.found.from_note:
        facts["note"] = "an earlier measurement had not put these back; this one has"
    return facts


def _print(result: TorqueBacklash, facts: dict[str, str], kept: Path) -> None:
    rows = [
        [
            f"{one.run}, {NAMES[one.trace.direction]}",
            number(one.published_um, 1),
            number(None if one.fitted is None else one.fitted.lost_motion_um),
            number(None if one.fitted is None else 1.96 * one.fitted.u_um),
            number(None if one.fitted is None else one.fitted.peak_um, 1),
        ]
        for one in result.reversals
    ]
    print_table(["run", "four-sample, µm", "fitted, µm", "± U95, µm", "break-away, µm"], rows)
    found = fitted_lost_motion(result.reversals)
    by_rule = mean_um(result.reversals, "four-sample")
    fitted = "–" if found is None else f"{found.mean_um:.2f} ± {found.u95_um:.2f} µm (95 %)"
    means = {"fitted": fitted, "four-sample": "–" if by_rule is None else f"{by_rule:.1f} µm"}
    print_facts({**{f"mean, {name}": text for name, text in means.items()}, **facts, "readings": str(kept)})
    if result.lost_motion_um is None:
        print(verdict(result))


def verdict(result: TorqueBacklash) -> str:
    """The sentence for a measurement without a value, empty for one with."""
    exceeded = result.exceeded
    if exceeded is None:
        return ""
    reach_um = float(exceeded.trace.travel_um[-1])
    seen = exceeded.published_um
    hint = (
        ""
        if seen is None
        else f"; the four-sample rule has a peak at {seen:.1f} µm, finer steps may show a wind-up there"
    )
    return (
        f"detection limit exceeded: {NAMES[exceeded.trace.direction]} shows no break-away within {reach_um:.0f} µm"
        f" ({len(exceeded.trace.position_load_mm) - 1} steps); everything is as it was, nothing was written{hint}"
    )


def _write_report(
    path: str, axis: DriveAxis, how: BacklashConfig, result: TorqueBacklash, facts: dict[str, str]
) -> None:
    from hil.report.torque_backlash import BacklashReport, render_backlash  # noqa: PLC0415  (plots are slow to import)

    identity = {
        "Axis": axis.name,
        "Drive": drive_in_words(axis),
        "Measured": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        "Reversals": ", ".join(f"{NAMES[each]} at {how.turning_mm(each):g} mm" for each in DIRECTIONS),
        "Steps": f"{how.step_um:g} µm at {how.velocity_mm_s:g} mm/s, {how.readings} readings after {how.settle_s:g} s at rest",
    }
    title = f"Lost motion of axis {axis.name} by torque"
    page = render_backlash(BacklashReport(title, result.reversals, how.method, verdict(result), identity, facts))
    replace_file(path, page.encode())


def _form(axis: DriveAxis, how: BacklashConfig, settings: BacklashSettings, result: TorqueBacklash) -> dict[str, Any]:
    found = fitted_lost_motion(result.reversals)
    return {
        "axis": axis.name,
        "good": result.lost_motion_um is not None,
        "detection_limit_exceeded": result.exceeded is not None,
        "method": how.method,
        "lost_motion_um": result.lost_motion_um,
        "fitted": None if found is None else {"mean_um": found.mean_um, "u95_um": found.u95_um},
        "four_sample": {"mean_um": mean_um(result.reversals, "four-sample")},
        "by_direction_um": {NAMES[each]: mean_um(result.reversals, how.method, each) for each in DIRECTIONS},
        "reversals": [reversal_json(one) for one in result.reversals],
        "parameters": {
            "before": result.found.values,
            "amount": settings.amount.name,
            "amount_um": settings.amount_um,
            "written": result.written,
        },
    }
