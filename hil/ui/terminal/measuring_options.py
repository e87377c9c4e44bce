"""Shared by the verbs that measure: recording and replay, and the passes in motion."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig, InstrumentConfig
from hil.machine.axes_wiring import connected_across
from hil.machine.conditions import Conditions
from hil.machine.in_motion_settings import InMotion
from hil.machine.machine import Machine
from hil.machine.who_is_there import naming_who_is_there
from hil.machine.wiring import connected
from hil.ui.terminal.axis_options import load_cross


def limited(axis: AxisConfig, limit_um: float | None) -> AxisConfig:
    """The axis with this limit of its accuracy in place of its file's, unless None."""
    if limit_um is None:
        return axis
    return replace(axis, correction=replace(axis.correction, accuracy_limit_um=limit_um))


def recording_name(args: argparse.Namespace) -> str:
    """File name of the replayed recording, "" for none."""
    return Path(args.replay).name if args.replay else ""


@contextmanager
def machine_of(
    args: argparse.Namespace, axis: AxisConfig, conditions: Conditions | None = None, *, moves_axis: str = ""
) -> Iterator[Machine]:
    """The connected axis, recorded with `--record`, or the axis of a recording.

    moves_axis: of the correction that will be in force; that axis is connected too, with its own stored correction.
    Raises as `connected`, `connected_across`, `recorded` and `replayed`, and InputError for a recording where another axis moves.
    """
    recorded_to, replayed_from = getattr(args, "record", None), getattr(args, "replay", None)
    if recorded_to or replayed_from:
        from hil.machine.replay import recorded, replayed  # noqa: PLC0415  (a job seldom records, and starts sooner)
    if moves_axis and (recorded_to or replayed_from):
        raise InputError(f"a recording holds one axis, and the stored straightness moves axis {moves_axis} too")
    if replayed_from:
        with replayed(axis, Path(replayed_from)) as machine:
            yield machine
        return
    with ExitStack() as stack:
        if moves_axis:
            own = load_cross(args, axis)
            with naming_who_is_there(axis):
                machine = stack.enter_context(connected_across(axis, conditions))
            if machine.session.cross is not None:
                machine.session.cross.corrected_by(own)
        else:
            with naming_who_is_there(axis):
                machine = stack.enter_context(connected(axis, conditions=conditions))
        if recorded_to:
            stack.enter_context(recorded(machine, Path(recorded_to)))
        stack.callback(_tell_notes, machine)
        yield machine


def _tell_notes(machine: Machine) -> None:
    """What was found of the drive while it moved and nothing has told yet."""
    for note in machine.session.untold_notes():
        print(f"hil: {note}", file=sys.stderr)


def passes_of(args: argparse.Namespace, at: tuple[float, ...], instrument: InstrumentConfig) -> InMotion:
    """The passes of a command line, with the instrument's latency and trigger of the axis file. at: feeds, mm/s."""
    return InMotion(
        at,
        stretch_mm=args.stretch,
        period_s=args.period,
        latency_s=instrument.latency_s,
        trigger_input=instrument.trigger_input,
    )
