"""`hil params table`: the correction table that a drive holds and applies itself."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

from drivers.correction_table import TableDescription
from hil.axis.axis_file import AxisConfig, load_axis, load_drive_axis
from hil.drive_table import DEVIATION_UM, DriveTable
from hil.drive_table.change import Snapshot
from hil.drive_table.job import (
    NOTE,
    PROVERS,
    ConnectedAxis,
    Proving,
    Stored,
    download,
    held,
    made_table,
    prove,
    remove,
    require_description,
)
from hil.drive_table.proof import TOLERANCE_UM, Proof
from hil.machine.wiring import connected, connected_drive, predicted_table_s
from hil.ui.terminal.axis_options import load_stored, open_store, tell_bench
from hil.ui.terminal.options import add_axis_arguments, add_password_options, positive, seed
from hil.ui.terminal.output import finish, number, print_facts, print_table, write_json
from hil.ui.terminal.progress import terminal_progress


def description_facts(found: TableDescription) -> dict[str, str]:
    """The properties of a drive's table, as label -> text."""
    between = {"linear": "straight between nodes", "step": "the value of the node before"}[found.interpolation.value]
    return {
        "table": f"{found.name}, {found.points} points at most",
        "nodes": f"{found.nodes.value}, {between}, outside: {found.outside.value}",
        "directions": found.directions.value,
        "positions in": f"{found.position.scale:g} {found.position.unit}",
        "values in": f"{found.value.scale:g} {found.value.unit}, {'added' if found.sign > 0 else 'subtracted'}",
        "memory": "wears with every write" if found.wears else "working memory, gone without power unless stored",
    }


def found_facts(found: Snapshot) -> dict[str, str]:
    """The drive's present contents, as label -> text."""
    return {"holds": f"{len(found.raw.plus)} points", "corrects by it": "yes" if found.enabled else "no"}


def made_facts(made: DriveTable) -> dict[str, str]:
    """A table made for the drive, and its deviation, as label -> text."""
    return {
        "points": str(len(made.raw.plus)),
        "largest correction": f"{made.largest_um:.2f} µm",
        "off the stored tables by": f"{made.deviation_um:.3f} µm at most, {made.rounding_um:.3f} µm of it by rounding",
    }


def print_proof(proof: Proof | None) -> None:
    """Prints the proof position by position, and the verdict."""
    if proof is None:
        print("not proven: no proof was requested (--prove-by)")
        return
    cells = {(place.target_mm, place.direction): place.difference_um for place in proof.places}
    rows = [
        [number(target, 3), number(cells[target, 1], 3), number(cells[target, -1], 3)]
        for target in dict.fromkeys(place.target_mm for place in proof.places if place.direction > 0)
    ]
    print_table(["position, mm", "drive − bridge going +, µm", "going −, µm"], rows)
    print(f"{'measured' if proof.measured else 'by the drive’s own value'}: {proof.verdict}")


EXAMPLE = """\
example:
  hil params table show X.toml                        what the drive holds, and whether it corrects by it
  hil params table download X.toml --dry-run          what would be written, and how near it comes to the stored tables
  hil params table download X.toml                    write, read back, prove on the machine, and switch it on
  hil params table prove X.toml --prove-by drive      the same proof by the value the drive reports, without an instrument
  hil params table remove X.toml                      switch it off and empty it

The drive's table is described in a map: correction_table in [drive] of the axis file (CANopen), [drive.correction_table] of the
register map (Modbus). The drive's correction and the bridge's are never in force together; calibrate, verify and close-loop refuse to
start while the drive's is on. After any error, or Ctrl-C, the drive is restored. Exit status 1: not proven.
"""
_SHOWN_ROWS = 24


def add_jobs(jobs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Adds `table` to the jobs of `hil params`."""
    parser = jobs.add_parser(
        "table",
        help="the correction table that the drive holds itself",
        description="Write the stored correction into the drive's own table, prove it there, or take it out.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parts = parser.add_subparsers(title="jobs", metavar="JOB", required=True)
    for name, text, run in (
        ("show", "what the drive holds", _show),
        ("download", "write the stored tables into the drive, read back, prove, switch on", _download),
        ("prove", "prove that the drive corrects as the bridge does", _prove),
        ("remove", "switch the drive's correction off and empty its table", _remove),
    ):
        job = parts.add_parser(
            name, help=text, description=text, epilog=EXAMPLE, formatter_class=argparse.RawDescriptionHelpFormatter
        )
        add_axis_arguments(job)
        if name in ("download", "prove"):
            _add_proof_options(job, unproven=name == "download")
        if name == "remove":
            job.add_argument("--keep-contents", action="store_true", help="switch it off only")
        job.set_defaults(run=run)


def _add_proof_options(job: argparse.ArgumentParser, *, unproven: bool) -> None:
    job.add_argument(
        "--prove-by",
        choices=[one for one in PROVERS if unproven or one != "nothing"],
        default="instrument",
        help="measure it (default), or read the value that the drive adds" + (", or neither" if unproven else ""),
    )
    job.add_argument(
        "--positions",
        type=_between(2, 200),
        default=7,
        metavar="N",
        help="number of positions of the proof (default 7)",
    )
    job.add_argument("--runs", type=_between(1, 100), default=2, metavar="N", help="of each block (default 2)")
    job.add_argument(
        "--tolerance-um", type=positive, default=TOLERANCE_UM, metavar="UM", help="of the proof (default %(default)s)"
    )
    if unproven:
        job.add_argument(
            "--deviation-um",
            type=positive,
            default=DEVIATION_UM,
            metavar="UM",
            help="largest deviation of the drive's table from the stored ones (default %(default)s)",
        )
    job.add_argument("--seed", type=seed, default=1, help="chooses the positions (default 1)")
    job.add_argument(
        "--tables-only", action="store_true", help="leave fitted effects out, which a drive's table cannot hold"
    )
    add_password_options(job, key=False)


def _between(low: int, high: int) -> Any:
    def convert(text: str) -> int:
        if not (text.isascii() and text.isdecimal() and low <= int(text) <= high):
            raise argparse.ArgumentTypeError(f"is {text!r}, expected a whole number, {low} to {high}")
        return int(text)

    return convert


def _proving(args: argparse.Namespace) -> Proving:
    return Proving(args.prove_by, args.positions, args.runs, args.tolerance_um, args.seed)


def _stored(args: argparse.Namespace, axis: AxisConfig) -> Stored:
    return Stored.of(load_stored(open_store(args, axis, writing=False)), leave_out_effects=args.tables_only)


@contextmanager
def _open(axis: AxisConfig, how: Proving) -> Iterator[ConnectedAxis]:
    """The axis, with its instrument where that proves."""
    with ExitStack() as stack:
        listener = stack.enter_context(terminal_progress())
        if how.by == "instrument":
            session = stack.enter_context(connected(axis)).session
            yield ConnectedAxis(axis, session.drive, session, listener)
        else:
            yield ConnectedAxis(axis, stack.enter_context(connected_drive(axis)), None, listener)


# -- jobs ----------------------------------------------------------------------------------------------------------------
def _show(args: argparse.Namespace) -> int:
    axis = load_drive_axis(args.axis)
    if args.dry_run:
        print(f"axis {axis.name}: would read the drive's table and move nothing")
        return 0
    with connected_drive(axis) as drive:
        there = held(axis, drive)
    nodes = there.curve.nodes_mm
    plus, minus = there.curve.correction_um(nodes, 1), there.curve.correction_um(nodes, -1)
    made_in = "not known" if there.zero is None else there.zero.describe()
    print_facts({**description_facts(there.description), **found_facts(there.found), "made in the zero": made_in})
    if (axis.store.directory / NOTE).exists():
        print(f"a change of it was broken off; what was there before is in {axis.store.directory / NOTE}")
    rows = [[number(p, 4), number(u, 2), number(d, 2)] for p, u, d in zip(nodes, plus, minus, strict=True)]
    print_table(["position, mm", "added going +, µm", "added going −, µm"], rows[:_SHOWN_ROWS])
    if len(rows) > _SHOWN_ROWS:
        print(f"and {len(rows) - _SHOWN_ROWS} more (--json has them all)")
    if args.json:
        values = {"position_mm": nodes.tolist(), "plus_um": plus.tolist(), "minus_um": minus.tolist()}
        write_json(args.json, {"axis": axis.name, "enabled": there.found.enabled, "points": len(nodes), **values})
    return 0


def _download(args: argparse.Namespace) -> int:
    axis, how = load_axis(args.axis), _proving(args)
    description = require_description(axis)
    stored = _stored(args, axis)
    made = made_table(axis, stored, args.deviation_um)
    facts = {**description_facts(description), **made_facts(made)}
    if args.dry_run:
        print_facts(facts)
        print(f"axis {axis.name}: would write {len(made.raw.plus)} points to the drive and read them back")
        busy = predicted_table_s(axis, made.raw)
        if busy is not None:
            print(f"would keep a free bus busy for at most {busy * 1000:.1f} ms, without the drive's own delays")
        _print_plan(how, axis)
        return 0
    with _open(axis, how) as there:
        found = download(there, stored, made, how, _say)
    print_facts({**facts, "written and read back in": f"{found.seconds * 1000:.0f} ms"})
    print_proof(found.proof)
    print("put back as it was found" if found.undone else "the drive corrects by it now; the bridge must not")
    if not found.undone:
        tell_bench(axis)
    return finish(args, found)


def _prove(args: argparse.Namespace) -> int:
    axis, how = load_axis(args.axis), _proving(args)
    stored = _stored(args, axis)
    if args.dry_run:
        _print_plan(how, axis)
        return 0
    with _open(axis, how) as there:
        found = prove(there, stored, how)
    print(f"by its numbers the drive's table is {found.deviation_um:.3f} µm off the stored ones at most")
    print_proof(found.proof)
    return finish(args, found)


def _print_plan(how: Proving, axis: AxisConfig) -> None:
    if how.by == "nothing":
        print("would move nothing")
        return
    targets = ", ".join(f"{target:g}" for target in how.targets_mm(axis))
    if how.by == "drive":
        print(f"would move through {targets} mm up and down, and ask the drive what it adds at each")
        return
    print(
        f"would measure {targets} mm, {how.runs} runs each of bridge, drive, drive, bridge, the axis disabled in between"
    )


def _remove(args: argparse.Namespace) -> int:
    axis = load_drive_axis(args.axis)
    if args.dry_run:
        print(
            f"axis {axis.name}: would switch the drive's correction off{'' if args.keep_contents else ' and empty its table'}"
        )
        return 0
    with connected_drive(axis) as drive:
        found = remove(axis, drive, _say, keep_contents=args.keep_contents)
    print_facts(found_facts(found))
    if args.json:
        write_json(args.json, {"axis": axis.name, "enabled": found.enabled, "points": len(found.raw.plus)})
    return 0


def _say(text: str) -> None:
    print(f"hil: {' '.join(text.split())}", file=sys.stderr)
