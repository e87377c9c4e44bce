"""`hil params table`: the correction table that a drive holds and applies itself."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivers.correction_table import TableDescription
from drivers.drive import ServoDrive
from drivers.errors import CapabilityError
from hil.axis.axis_file import AxisConfig, DriveAxis, iso_targets, load_axis, load_drive_axis
from hil.axis.zero import made_with_keeper, zero_keeper
from hil.correction.compensation import Compensation
from hil.correction.formats.common import tables_only
from hil.correction.store import compensation_in_force
from hil.correction.tables import DirectionalTable
from hil.drive_table import (
    DEVIATION_UM,
    DriveCurve,
    DriveTable,
    check_curve,
    drive_table,
    largest_deviation_um,
    wanted_of,
)
from hil.drive_table.change import (
    Snapshot,
    TableChange,
    changing,
    held_table,
    remember_zero,
    remembered_made_with,
    remembered_zero,
    snapshot,
    zero_note,
)
from hil.drive_table.proof import TOLERANCE_UM, Proof, ProofMotion, prove_by_drive, prove_by_instrument
from hil.machine.events import Listener
from hil.machine.machine import Machine
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.machine.wiring import connected, connected_drive, described_table, predicted_table_s
from hil.records.journal import Campaign
from hil.records.made_with import MadeWith, MadeWithError
from hil.records.zero import read_zero
from hil.ui.terminal.axis_options import load_stored, open_store, tell_bench
from hil.ui.terminal.options import add_axis_arguments, add_password_options, positive, seed
from hil.ui.terminal.output import number, print_facts, print_table, write_json
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


def made_form(made: DriveTable) -> dict[str, Any]:
    """The same as plain values, µm."""
    return {
        "points": len(made.raw.plus),
        "deviation_um": made.deviation_um,
        "rounding_um": made.rounding_um,
        "largest_um": made.largest_um,
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


def proof_form(axis: str, proof: Proof | None) -> dict[str, Any]:
    """Axis, verdict and every position as plain values."""
    form: dict[str, Any] = {"axis": axis, "good": proof is None or proof.good, "proof": None}
    if proof is not None:
        form["proof"] = {
            "measured": proof.measured,
            "verdict": proof.verdict,
            "mean_um": proof.mean_um,
            "worst_um": proof.worst.difference_um,
            "u95_um": proof.u95_um,
            "tolerance_um": proof.tolerance_um,
            "share": proof.share,
            "places": [vars(place) for place in proof.places],
        }
    return form


NOTE = "drive-table-before.json"
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
        choices=("instrument", "drive", *(["nothing"] if unproven else [])),
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


# -- show ----------------------------------------------------------------------------------------------------------------
def _show(args: argparse.Namespace) -> int:
    axis = load_drive_axis(args.axis)
    if args.dry_run:
        print(f"axis {axis.name}: would read the drive's table and move nothing")
        return 0
    with connected_drive(axis) as drive:
        table = held_table(drive)
        found = snapshot(table)
        curve = DriveCurve(table.description, found.raw, drive.scaling)
    nodes = curve.nodes_mm
    plus, minus = curve.correction_um(nodes, 1), curve.correction_um(nodes, -1)
    zero = remembered_zero(_zero_note(axis), found.raw)
    made_in = "not known" if zero is None else zero.describe()
    print_facts({**description_facts(table.description), **found_facts(found), "made in the zero": made_in})
    if (axis.store.directory / NOTE).exists():
        print(f"a change of it was broken off; what was there before is in {axis.store.directory / NOTE}")
    rows = [[number(p, 4), number(u, 2), number(d, 2)] for p, u, d in zip(nodes, plus, minus, strict=True)]
    print_table(["position, mm", "added going +, µm", "added going −, µm"], rows[:_SHOWN_ROWS])
    if len(rows) > _SHOWN_ROWS:
        print(f"and {len(rows) - _SHOWN_ROWS} more (--json has them all)")
    if args.json:
        values = {"position_mm": nodes.tolist(), "plus_um": plus.tolist(), "minus_um": minus.tolist()}
        write_json(args.json, {"axis": axis.name, "enabled": found.enabled, "points": len(nodes), **values})
    return 0


# -- download ------------------------------------------------------------------------------------------------------------
def _download(args: argparse.Namespace) -> int:
    axis = load_axis(args.axis)
    description = described_table(axis)
    if description is None:
        raise CapabilityError(f"axis {axis.name}: no map describes a correction table of its drive (correction_table)")
    compensation, wanted = _stored(args, axis)
    how = {"deviation_um": args.deviation_um, "bound": axis.correction.bound}
    made = drive_table(wanted, description, axis.scaling, axis.limits, **how)
    facts = {**description_facts(description), **made_facts(made)}
    if args.dry_run:
        print_facts(facts)
        print(f"axis {axis.name}: would write {len(made.raw.plus)} points to the drive and read them back")
        busy = predicted_table_s(axis, made.raw)
        if busy is not None:
            print(f"would keep a free bus busy for at most {busy * 1000:.1f} ms, without the drive's own delays")
        _print_plan(args, axis)
        return 0
    say, note = _say, axis.store.directory / NOTE
    zero = zero_keeper(axis).kept(tables=compensation.zero)
    with terminal_progress() as listener:
        if args.prove_by == "instrument":
            with connected(axis) as machine, changing(machine.session.drive, note, say) as change:
                made_with = _made_with(axis, change.drive, compensation)
                change.write(made.raw)
                proof: Proof | None = _by_instrument(args, axis, machine, compensation, listener)
                _settle(change, proof)
        else:
            with connected_drive(axis) as drive, changing(drive, note, say) as change:
                made_with = _made_with(axis, drive, compensation)
                change.write(made.raw)
                proof = None
                if args.prove_by == "drive":
                    with Supervisor([WatchedAxis(drive)]) as moving:
                        proof = _by_drive(args, axis, moving, wanted, listener)
                _settle(change, proof)
    if not change.undone:
        zero = compensation.zero or zero or read_zero(axis.zero_path)
        remember_zero(_zero_note(axis), made.raw, zero, made_with)
    print_facts({**facts, "written and read back in": f"{change.seconds * 1000:.0f} ms"})
    print_proof(proof)
    print("put back as it was found" if change.undone else "the drive corrects by it now; the bridge must not")
    if not change.undone:
        tell_bench(axis)
    if args.json:
        write_json(args.json, {**proof_form(axis.name, proof), **made_form(made), "seconds": change.seconds})
    return 0 if proof is None or proof.good else 1


def _made_with(axis: AxisConfig, drive: ServoDrive, compensation: Compensation) -> MadeWith:
    """What the open drive has. Raises MadeWithError unless the tables were made with it; tables that take the reversal out and state
    nothing must find the drive's own amount 0.
    """
    keeper, reversal = made_with_keeper(axis), compensation.corrects_reversal
    keeper.check(drive, compensation.made_with, reversal=reversal)
    now = keeper.now(drive, compensation.made_with)
    held = {address: value for address, value in now.backlash.items() if value}
    if compensation.made_with is None and reversal and held:
        raise MadeWithError(
            f"axis {axis.name}: its tables do not state which parameters the drive had, and with {', '.join(held)} ="
            f" {', '.join(f'{value:g}' for value in held.values())} the reversal may be taken out twice: calibrate anew"
            f" (hil calibrate {axis.path}), or set it to 0"
        )
    return now


def _settle(change: TableChange, proof: Proof | None) -> None:
    """Switches the table on where it was proven (or no proof was requested), else undoes the change."""
    if proof is None or proof.good:
        change.switch(True)
    else:
        change.undo()


def _stored(args: argparse.Namespace, axis: AxisConfig) -> tuple[Compensation, DirectionalTable]:
    """The bridge's compensation, and the table that a drive would have to hold in its place."""
    compensation = load_stored(open_store(args, axis, writing=False))
    wanted = wanted_of(compensation, leave_out_effects=args.tables_only)
    return (
        replace(compensation, tables=tables_only(compensation, leave_out_effects=True), terms=(), rise=None)
        if args.tables_only
        else compensation
    ), wanted


def _zero_note(axis: DriveAxis) -> Path:
    return zero_note(axis.store.directory, axis.name)


# -- prove ---------------------------------------------------------------------------------------------------------------
def _prove(args: argparse.Namespace) -> int:
    axis = load_axis(args.axis)
    compensation, wanted = _stored(args, axis)
    if args.dry_run:
        _print_plan(args, axis)
        return 0
    zero_keeper(axis).kept(tables=compensation.zero)
    with terminal_progress() as listener:
        if args.prove_by == "instrument":
            with connected(axis) as machine:
                held = _held(machine.session.drive, wanted, axis)
                proof = _by_instrument(args, axis, machine, compensation, listener)
        else:
            with connected_drive(axis) as drive, Supervisor([WatchedAxis(drive)]) as moving:
                held = _held(drive, wanted, axis)
                proof = _by_drive(args, axis, moving, wanted, listener)
    print(f"by its numbers the drive's table is {held:.3f} µm off the stored ones at most")
    print_proof(proof)
    if args.json:
        write_json(args.json, {**proof_form(axis.name, proof), "deviation_um": held})
    return 0 if proof.good else 1


def _held(drive: Any, wanted: DirectionalTable, axis: AxisConfig) -> float:
    """Deviation of the drive's table from the stored ones, µm. Raises ZeroError and MadeWithError, before any motion,
    for a table of another zero, or made with other parameters.
    """
    table = held_table(drive)
    raw = table.read()
    zero_keeper(axis).kept(tables=remembered_zero(_zero_note(axis), raw))
    made_with_keeper(axis).check(drive, remembered_made_with(_zero_note(axis), raw), reversal=True)
    curve = DriveCurve(table.description, raw, axis.scaling)
    check_curve(curve, axis.limits, axis.correction.bound)  # the proof switches it on
    return largest_deviation_um(curve, wanted, axis.limits.travel_min_mm, axis.limits.travel_max_mm)


def _targets(args: argparse.Namespace, axis: AxisConfig) -> tuple[float, ...]:
    """Positions spread over the measured travel, off the nodes."""
    where = axis.measurement.targets_mm
    return iso_targets(where[0], where[-1], args.positions, 0.3, args.seed)


def _by_instrument(
    args: argparse.Namespace, axis: AxisConfig, machine: Machine, compensation: Compensation, listener: Listener
) -> Proof:
    targets = _targets(args, axis)
    proof = {"targets_mm": list(targets), "runs": args.runs}
    purpose = {**axis.purpose("prove-drive-table"), **compensation_in_force(compensation), "proof": proof}
    campaign = Campaign.numbered(axis.store.directory, purpose, resume=False)
    return prove_by_instrument(
        machine.session, campaign, compensation, targets, listener, runs=args.runs, tolerance_um=args.tolerance_um
    )


def _by_drive(
    args: argparse.Namespace, axis: AxisConfig, moving: Supervisor, wanted: DirectionalTable, listener: Listener
) -> Proof:
    how = axis.measurement
    way = ProofMotion(how.velocity_mm_s, how.overrun_mm, how.home)
    return prove_by_drive(moving, wanted, _targets(args, axis), way, listener, tolerance_um=args.tolerance_um)


def _print_plan(args: argparse.Namespace, axis: AxisConfig) -> None:
    if args.prove_by == "nothing":
        print("would move nothing")
        return
    targets = ", ".join(f"{target:g}" for target in _targets(args, axis))
    if args.prove_by == "drive":
        print(f"would move through {targets} mm up and down, and ask the drive what it adds at each")
        return
    print(
        f"would measure {targets} mm, {args.runs} runs each of bridge, drive, drive, bridge, the axis disabled in between"
    )


# -- remove --------------------------------------------------------------------------------------------------------------
def _remove(args: argparse.Namespace) -> int:
    axis = load_drive_axis(args.axis)
    if args.dry_run:
        print(
            f"axis {axis.name}: would switch the drive's correction off{'' if args.keep_contents else ' and empty its table'}"
        )
        return 0
    note: Path = axis.store.directory / NOTE
    with connected_drive(axis) as drive, changing(drive, note, _say) as change:
        if args.keep_contents:
            change.switch(False)
        else:
            change.write(type(change.found.raw)())
            _zero_note(axis).unlink(missing_ok=True)
        found = snapshot(change.table)
    print_facts(found_facts(found))
    if args.json:
        write_json(args.json, {"axis": axis.name, "enabled": found.enabled, "points": len(found.raw.plus)})
    return 0


def _say(text: str) -> None:
    print(f"hil: {' '.join(text.split())}", file=sys.stderr)
