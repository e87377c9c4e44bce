"""`hil circle`: two axes drive a circle together; lost motion shows as bumps where one of them reverses."""

from __future__ import annotations

import argparse

from drivers.files import replace_file
from hil.axis.axis_file import AxisConfig, load_axis
from hil.correction.compensation import Compensation
from hil.correction.store import bound_tables
from hil.effects.user_effects import catalogue_with
from hil.lost_motion.circle.figures import QUADRANTS_DEG, Circle, by_standard
from hil.lost_motion.circle.job import VERDICT, DrivenCircle, form, middle_of, report_html, run_circle
from hil.machine.axes_wiring import connected_axes
from hil.ui.terminal.axis_options import load_stored, open_store, tell_zero
from hil.ui.terminal.output import number, print_facts, print_table, write_json
from hil.ui.terminal.progress import terminal_progress
from hil.ui.terminal.summary import print_paths

MM_MIN = 60.0


def run(args: argparse.Namespace) -> int:
    """Returns 0: driven, and better with the correction where there is one; 1: not better. Raises what `run_circle`
    raises.
    """
    axes = (load_axis(args.x), load_axis(args.y))
    first, second = args.centre or middle_of(axes)
    circle = Circle((first, second), args.radius, args.feed / MM_MIN, -1 if args.clockwise else 1)
    if args.dry_run:
        _print_plan(axes, circle, args)
        return 0
    stored = [None if args.uncorrected else _stored(args, axis) for axis in axes]
    with connected_axes(axes) as machines, terminal_progress() as listener:
        for machine in machines:
            tell_zero(args, machine)
        driven = run_circle(machines, circle, stored, listener, period_s=args.period_ms / 1000.0)
    _print(driven)
    if args.report:
        replace_file(args.report, report_html(driven).encode())
    if args.json:
        write_json(args.json, form(driven))
    return 0 if driven.good else 1


def _stored(args: argparse.Namespace, axis: AxisConfig) -> Compensation | None:
    if bound_tables(axis) is None:
        return None
    return load_stored(open_store(args, axis, writing=False), catalogue_with(args.effects))


def _print_plan(axes: tuple[AxisConfig, AxisConfig], circle: Circle, args: argparse.Namespace) -> None:
    for axis, centre in zip(axes, circle.centre_mm, strict=True):
        low, high = centre - circle.radius_mm, centre + circle.radius_mm
        homing = "home it, " if axis.measurement.home else ""
        print(
            f"axis {axis.name} over {axis.drive.backend}: would enable it, {homing}take its datum at"
            f" {axis.measurement.reference_mm:g} mm, and move between {low:g} and {high:g} mm (corrections come on top)"
        )
    sense = "counter-clockwise" if circle.sense > 0 else "clockwise"
    stored = {axis.name: None if args.uncorrected else bound_tables(axis) for axis in axes}
    tables = [name for name, bound in stored.items() if bound is not None]
    lost_motion = [name for name, bound in stored.items() if bound is not None and bound.lost_motion]
    how = ", then ".join(
        ["uncorrected"]
        + ([f"with the tables of {' and '.join(tables)}"] if tables else [])
        + ([f"with these and the lost motion of {' and '.join(lost_motion)}"] if lost_motion else [])
    )
    print(
        f"would drive {circle.radius_mm:g} mm {sense} at {60 * circle.feed_mm_s:g} mm/min, {how}:"
        f" {circle.duration_s:.0f} s each, a set-point every {args.period_ms:g} ms"
    )
    print(f"would write rows below {axes[0].store.directory}")


def _print(driven: DrivenCircle) -> None:
    rows = [
        [
            driven.label(name),
            *(number(b) for b in one.bumps_um),
            number(one.bump_mean_um),
            number(one.floor_um),
            number(one.roundness_um),
        ]
        for name, one in driven.traces.items()
    ]
    heads = [f"{at:g}°" for at in QUADRANTS_DEG]
    print_table(["bump in µm, after", *heads, "mean", "floor", "roundness"], rows)
    print_paths({driven.label(name): by_standard(one, driven.circle).paths[0] for name, one in driven.traces.items()})
    facts = {"rows": str(driven.kept)}
    if driven.fallen_percent is not None:
        facts = {"bumps fallen by": f"{driven.fallen_percent:.1f} %", **facts}
    if driven.fallen_by_tables_percent is not None:
        facts = {"bumps fallen by tables alone": f"{driven.fallen_by_tables_percent:.1f} %", **facts}
    if driven.missed:
        facts["set-points missed"] = str(driven.missed)
    print_facts(facts)
    if driven.comparison:
        print(driven.comparison)
    if driven.uncorrected:
        print(driven.uncorrected)
    if not driven.good:
        print(VERDICT)
