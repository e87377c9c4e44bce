"""`hil circle`: two axes drive a circle together, and their lost motion shows as bumps where one of them turns around."""

from __future__ import annotations

import argparse
import math
from datetime import datetime
from pathlib import Path
from typing import Any

from hil.axes_wiring import connected_axes
from hil.axis import AxisConfig, load_axis
from hil.cli.axis_options import add_password_options, open_store
from hil.cli.effects_input import add_effects_option, read_effects
from hil.cli.output import add_json_option, number, print_facts, print_table, write_json
from hil.cli.progress import terminal_progress
from hil.compensation import Compensation
from hil.files import replace_file
from hil.journal import Campaign
from hil.lost_motion.circle import QUADRANTS_DEG, Circle, Trace
from hil.procedures.circle import CircleRun, check_axes, drive_circle, prepare
from hil.store import compensation_in_force

EXAMPLE = """\
example:
  hil circle X.toml Y.toml --dry-run                   what would move, and how far
  hil circle X.toml Y.toml --report circle.html        10 mm at 100 mm/min: uncorrected, then with what is stored for both axes
  hil circle X.toml Y.toml --centre 120 80 --clockwise

Both drives take set-points together: on one CAN bus by one SYNC, otherwise by this computer's clock. Both instruments measure. An axis
without stored tables drives uncorrected. `hil lost-motion` makes the correction that this is to show.
Exit status 1: with the correction in force the bumps fell neither to half nor to the floor.
"""
BEFORE, AFTER = "uncorrected", "corrected"
MM_MIN = 60.0


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "circle",
        help="two axes drive a circle: what lost motion does at the quadrants",
        description="Drive a circle with two axes, uncorrected and corrected, and read the bumps after the quadrants.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("x", metavar="X.toml", help="the axis file of the first axis")
    parser.add_argument("y", metavar="Y.toml", help="the axis file of the second axis")
    parser.add_argument("--dry-run", action="store_true", help="say what would be moved and written, and do nothing")
    add_json_option(parser)
    parser.add_argument(
        "--centre", metavar="MM", nargs=2, type=_finite, help="of both axes (default: the middles of their targets)"
    )
    parser.add_argument("--radius", metavar="MM", type=_positive, default=10.0, help="default 10")
    parser.add_argument("--feed", metavar="MM/MIN", type=_positive, default=100.0, help="default 100")
    parser.add_argument("--clockwise", action="store_true", help="instead of counter-clockwise")
    parser.add_argument("--period-ms", metavar="MS", type=_positive, default=4.0, help="of the set-points (default 4)")
    parser.add_argument("--uncorrected", action="store_true", help="only that; needs no password")
    parser.add_argument("--report", metavar="FILE.html", help="also write a report")
    add_password_options(parser, key=False)
    add_effects_option(parser)
    parser.set_defaults(run=run)


def _finite(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a number")
    return value


def _positive(text: str) -> float:
    value = _finite(text)
    if not value > 0.0:
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a number > 0")
    return value


def run(args: argparse.Namespace) -> int:
    """0: driven, and better with the correction where there is one; 1: not better."""
    axes = (load_axis(args.x), load_axis(args.y))
    middles = [0.5 * (min(axis.measurement.targets_mm) + max(axis.measurement.targets_mm)) for axis in axes]
    first, second = args.centre or [round(middle, 3) for middle in middles]
    circle = Circle((first, second), args.radius, args.feed / MM_MIN, -1 if args.clockwise else 1)
    if args.dry_run:
        _print_plan(axes, circle, args)
        return 0
    stored = [None if args.uncorrected else _stored(args, axis) for axis in axes]
    wanted: dict[str, list[Compensation | None]] = {BEFORE: [None, None]}
    wanted |= {AFTER: stored} if any(one is not None for one in stored) else {}
    with connected_axes(axes) as machines, terminal_progress() as listener:
        sessions = [machine.session for machine in machines]
        check_axes(sessions, circle, args.period_ms / 1000.0)
        campaign = Campaign.numbered(axes[0].store.directory, _purpose(axes, circle, stored), resume=False)
        prepare(sessions)
        runs = {}
        for name, corrections in wanted.items():
            stage, period_s = f"circle, {name}", args.period_ms / 1000.0
            runs[name] = drive_circle(sessions, circle, corrections, stage=stage, period_s=period_s, listener=listener)
            campaign.write(f"{name}.csv", _csv(runs[name], axes))
    traces = {name: each.trace for name, each in runs.items()}
    good = _good(traces)
    _print(traces, runs, campaign.directory, good=good)
    if args.report:
        _write_report(args.report, axes, circle, traces, good)
    if args.json:
        write_json(args.json, _form(axes, circle, traces, runs, good))
    return 0 if good else 1


def _stored(args: argparse.Namespace, axis: AxisConfig) -> Compensation | None:
    if not axis.tables_path.exists():
        return None
    return open_store(args, axis, writing=False).load(read_effects(args.effects))


def _purpose(axes: tuple[AxisConfig, AxisConfig], circle: Circle, stored: list[Compensation | None]) -> dict[str, Any]:
    return {
        "kind": "circle",
        "axes": [axis.name for axis in axes],
        "centre_mm": list(circle.centre_mm),
        "radius_mm": circle.radius_mm,
        "feed_mm_s": circle.feed_mm_s,
        "sense": circle.sense,
        "in_force": [None if one is None else compensation_in_force(one) for one in stored],
    }


def _csv(run: CircleRun, axes: tuple[AxisConfig, AxisConfig]) -> bytes:
    names = ",".join(f"pos_{axis.name.lower()}_mm" for axis in axes)
    rows = [f"{t:.6f},{p[0]:.7f},{p[1]:.7f}" for t, p in zip(run.time_s, run.position_mm, strict=True)]
    return ("\n".join([f"time_s,{names}", *rows]) + "\n").encode()


def _good(traces: dict[str, Trace]) -> bool:
    if AFTER not in traces:
        return True
    after = traces[AFTER]
    return after.bump_mean_um <= max(0.5 * traces[BEFORE].bump_mean_um, after.floor_um)


def _print_plan(axes: tuple[AxisConfig, AxisConfig], circle: Circle, args: argparse.Namespace) -> None:
    for axis, centre in zip(axes, circle.centre_mm, strict=True):
        low, high = centre - circle.radius_mm, centre + circle.radius_mm
        homing = "home it, " if axis.measurement.home else ""
        print(
            f"axis {axis.name} over {axis.drive.backend}: would enable it, {homing}take its datum at"
            f" {axis.measurement.reference_mm:g} mm, and move between {low:g} and {high:g} mm (corrections come on top)"
        )
    sense = "counter-clockwise" if circle.sense > 0 else "clockwise"
    there = [axis.name for axis in axes if axis.tables_path.exists()]
    how = f"uncorrected, then with what is stored for {' and '.join(there)}" if there else "uncorrected"
    print(
        f"would drive {circle.radius_mm:g} mm {sense} at {60 * circle.feed_mm_s:g} mm/min, {how}:"
        f" {circle.duration_s:.0f} s each, a set-point every {args.period_ms:g} ms"
    )
    print(f"would write rows below {axes[0].store.directory}")


def _print(traces: dict[str, Trace], runs: dict[str, CircleRun], kept: Path, *, good: bool) -> None:
    rows = [
        [
            name,
            *(number(b) for b in one.bumps_um),
            number(one.bump_mean_um),
            number(one.floor_um),
            number(one.roundness_um),
        ]
        for name, one in traces.items()
    ]
    heads = [f"{at:g}°" for at in QUADRANTS_DEG]
    print_table(["bump in µm, after", *heads, "mean", "floor", "roundness"], rows)
    facts = {"rows": str(kept)}
    if AFTER in traces:
        fallen = 100.0 * (1.0 - traces[AFTER].bump_mean_um / traces[BEFORE].bump_mean_um)
        facts = {"bumps fallen by": f"{fallen:.1f} %", **facts}
    missed = sum(one.missed for one in runs.values())
    if missed:
        facts["set-points missed"] = str(missed)
    print_facts(facts)
    if not good:
        print(VERDICT)


VERDICT = "with the correction in force the bumps fell neither to half nor to the floor"


def _write_report(
    path: str, axes: tuple[AxisConfig, AxisConfig], circle: Circle, traces: dict[str, Trace], good: bool
) -> None:
    from hil.report.circle import CircleReport, render_circle  # noqa: PLC0415  (plots are slow to import)

    names = (axes[0].name, axes[1].name)
    identity = {
        "Axes": " and ".join(names),
        "Drives": " and ".join(
            f"{axis.drive.backend}, {axis.drive.machine} machine, as {axis.drive.face}"
            if axis.drive.backend == "bench"
            else axis.drive.backend
            for axis in axes
        ),
        "Measured": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        "Circle": f"{circle.radius_mm:g} mm around {circle.centre_mm[0]:g}, {circle.centre_mm[1]:g} mm,"
        f" {'counter-' if circle.sense > 0 else ''}clockwise at {60 * circle.feed_mm_s:g} mm/min",
    }
    title = f"Circle of axes {names[0]} and {names[1]}"
    report = CircleReport(title, traces, names, circle.sense, "" if good else VERDICT, identity)
    replace_file(path, render_circle(report).encode())


def _form(
    axes: tuple[AxisConfig, AxisConfig],
    circle: Circle,
    traces: dict[str, Trace],
    runs: dict[str, CircleRun],
    good: bool,
) -> dict[str, Any]:
    return {
        "axes": [axis.name for axis in axes],
        "good": good,
        "radius_mm": circle.radius_mm,
        "feed_mm_min": 60.0 * circle.feed_mm_s,
        "sense": circle.sense,
        "circles": {
            name: {
                "bumps_um": dict(zip((f"{at:g}" for at in QUADRANTS_DEG), one.bumps_um, strict=True)),
                "bump_mean_um": one.bump_mean_um,
                "floor_um": one.floor_um,
                "roundness_um": one.roundness_um,
                "missed_set_points": runs[name].missed,
                "angle_deg": one.angle_deg.tolist(),
                "deviation_um": one.deviation_um.tolist(),
            }
            for name, one in traces.items()
        },
        "fallen_percent": None
        if AFTER not in traces
        else 100.0 * (1.0 - traces[AFTER].bump_mean_um / traces[BEFORE].bump_mean_um),
    }
