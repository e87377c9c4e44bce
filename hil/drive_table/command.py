"""`hil params table`: the correction table that a drive holds and applies itself."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from drivers.correction_table import TableDescription
from hil.axis.axis_file import AxisConfig, load_axis, load_drive_axis
from hil.drive_table.change import Snapshot
from hil.drive_table.job import (
    NOTE,
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
from hil.drive_table.proof import TableProof
from hil.drive_table.quantise import DriveTable
from hil.machine.wiring import connected, connected_drive, predicted_table_s
from hil.ui.terminal.axis_options import load_stored, open_store, tell_bench
from hil.ui.terminal.output import finish, number, print_facts, print_table, say, write_json
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


def print_proof(proof: TableProof | None) -> None:
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


_SHOWN_ROWS = 24


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
def show_table(args: argparse.Namespace) -> int:
    """Say what the drive holds."""
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


def download_table(args: argparse.Namespace) -> int:
    """Write, read back, prove and switch on; exit status 1 where it is not proven."""
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
        found = download(there, stored, made, how, say)
    print_facts({**facts, "written and read back in": f"{found.seconds * 1000:.0f} ms"})
    print_proof(found.proof)
    print("put back as it was found" if found.undone else "the drive corrects by it now; the bridge must not")
    if not found.undone:
        tell_bench(axis)
    return finish(args, found)


def prove_table(args: argparse.Namespace) -> int:
    """Prove what the drive holds; exit status 1 where it is not."""
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


def remove_table(args: argparse.Namespace) -> int:
    """Switch it off, and empty it."""
    axis = load_drive_axis(args.axis)
    if args.dry_run:
        print(
            f"axis {axis.name}: would switch the drive's correction off{'' if args.keep_contents else ' and empty its table'}"
        )
        return 0
    with connected_drive(axis) as drive:
        found = remove(axis, drive, say, keep_contents=args.keep_contents)
    print_facts(found_facts(found))
    if args.json:
        write_json(args.json, {"axis": axis.name, "enabled": found.enabled, "points": len(found.raw.plus)})
    return 0
