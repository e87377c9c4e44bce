"""`hil doctor`: preflight of an axis."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any

from drivers.errors import InputError
from drivers.modbus.codec import Layout
from hil.axis.axis_file import AxisConfig, load_axis
from hil.calibration.latency import ENOUGH_S, measure_latency
from hil.doctor.procedure import Check, doctor, reach_mm
from hil.figures.alignment import Alignment
from hil.machine.machine import Machine
from hil.machine.who_is_there import naming_who_is_there
from hil.machine.wiring import connected, connected_registers
from hil.records.journal import Campaign
from hil.ui.terminal.measuring_options import passes_of
from hil.ui.terminal.output import print_table, write_json
from hil.ui.terminal.progress import terminal_progress


def run(args: argparse.Namespace) -> int:
    """Exit status 0: all checks good; 1: not."""
    axis = load_axis(args.axis)
    if args.probe_order is not None:
        return _probe_order(args, axis)
    if args.dry_run:
        if axis.drive.backend == "modbus":
            from hil.machine.modbus_wiring import check_registers  # noqa: PLC0415  (a verb loads the wire its axis file names)

            check_registers(axis)
        what = (
            "move nothing" if args.no_move else f"enable it and move it by up to {reach_mm(axis.limits):g} mm and back"
        )
        if args.latency:
            what += f"; then make passes of {args.stretch:g} mm and their ramps at {_listed(args.latency)} mm/s over its targets"
        print(f"axis {axis.name} over {axis.drive.backend}: would read drive and instrument, and {what}")
        return 0
    with _connected(axis) as machine:
        checks = doctor(machine.session, move=not args.no_move, trust_file=args.trust_file, home=args.home)
        if args.latency and not args.no_move and all(check.good for check in checks):
            checks.append(_latency(args, machine))
    if (beam := axis.instrument.alignment) is not None:
        checks.append(beam_check(beam))
    rows = [[check.name, check.verdict, check.detail] for check in checks]
    print_table(["check", ("verdict", "left"), ("found", "left")], rows)
    good = all(check.good for check in checks)
    if risks := sum(check.good and check.risk for check in checks):
        print(f"{risks} of {len(checks)} are no failure but a risk: read them before the axis moves")
    if args.json:
        write_json(args.json, {"axis": axis.name, "good": good, "checks": [vars(check) for check in checks]})
    return 0 if good else 1


@contextmanager
def _connected(axis: AxisConfig) -> Iterator[Machine]:
    """As `connected`; a drive that does not answer is named with who answers instead."""
    with ExitStack() as stack:
        with naming_who_is_there(axis):
            machine = stack.enter_context(connected(axis))
        yield machine


def _latency(args: argparse.Namespace, machine: Machine) -> Check:
    """Measure the latency and compare it with the axis file's, where it states one. The rows are kept as a campaign."""
    axis, stated_s = machine.axis, machine.axis.instrument.latency_s
    how = replace(passes_of(args, args.latency, axis.instrument), latency_s=None)
    purpose = {**axis.purpose("latency"), "in_motion": {**vars(how), "feeds_mm_s": list(args.latency)}}
    campaign = Campaign.numbered(axis.store.directory, purpose, resume=False)
    with terminal_progress() as listener:
        machine.session.prepare(campaign.directory)
        found = measure_latency(machine.session, campaign, how, listener)
    detail = found.describe()
    if found.straight is False:
        detail += "; not in proportion to the feed, so something else rises with it"
    if stated_s is None:
        return Check("latency", True, f"{detail}; for the axis file: latency_s = {round(found.latency_s, 6) + 0.0:g}")
    good = abs(found.latency_s - stated_s) <= found.within_s + ENOUGH_S
    return Check("latency", good, f"{detail}; the axis file has {1e3 * stated_s:g} ms")


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


def beam_check(beam: Alignment) -> Check:
    """Check of the beam's alignment, from the spots of the axis file."""
    detail = f"{beam.angle_mrad:.2f} mrad off the motion, reads {beam.short_ppm:.2f} ppm short, at most {beam.short_at_most_ppm:.2f}"
    if not beam.good:
        detail += f"; spots tell {beam.readable_mrad:.2f} mrad, so it can be aligned better"
    return Check("beam", beam.good, detail)


def _probe_order(args: argparse.Namespace, axis: AxisConfig) -> int:
    """Exit status 0: the register map reads the known value from the register; 1: it does not."""
    name, equals, text = args.probe_order.partition("=")
    try:
        value = float(text)
    except ValueError as error:
        raise InputError(f"--probe-order is {args.probe_order!r}, expected REGISTER=VALUE") from error
    if not equals or not math.isfinite(value):
        raise InputError(f"--probe-order is {args.probe_order!r}, expected REGISTER=VALUE")
    if args.dry_run:
        print(f"axis {axis.name}: would read register {name} and its neighbours")
        return 0
    with connected_registers(axis) as registers:
        register = registers.map.registers[name]
        matches = registers.probe_order(name, value, tolerance=args.tolerance)
    rows = [
        {
            "address": register.span.start + match.offset,
            "offset": match.offset,
            "type": match.layout.type.value,
            "word_order": match.layout.word_order.value,
            "byte_order": match.layout.byte_order.value,
            "value": match.value,
            "as_mapped": match.offset == 0 and match.layout == register.layout,
        }
        for match in matches
    ]
    good = any(row["as_mapped"] for row in rows)
    print_table(
        ["address (0-based)", ("type", "left"), ("word order", "left"), ("byte order", "left"), "value", ("", "left")],
        [_order_row(row) for row in rows],
        title=f"{name}: mapped at {register.span.start} as {_layout_text(register.layout)}",
    )
    if not rows:
        print(
            f"{text} is not found there, in no type and no order: another register, another scale, or a value that moved"
        )
    elif not good:
        print(f"{name} is mapped wrongly")
    elif any(row["type"] == register.layout.type.value and not row["as_mapped"] for row in rows):
        print("more than one place or order fits: choose a known value with four different bytes to tell them apart")
    if args.json:
        write_json(args.json, {"axis": axis.name, "register": name, "good": good, "matches": rows})
    return 0 if good else 1


def _order_row(row: dict[str, Any]) -> tuple[str, ...]:
    offset = f" ({row['offset']:+d})" if row["offset"] else ""
    mapped = "as mapped" if row["as_mapped"] else ""
    return f"{row['address']}{offset}", row["type"], row["word_order"], row["byte_order"], f"{row['value']:g}", mapped


def _layout_text(layout: Layout) -> str:
    return f"{layout.type.value}, word order {layout.word_order.value}, byte order {layout.byte_order.value}"
