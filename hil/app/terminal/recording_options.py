"""What verbs share that measure at rest: recording drive and instrument together, and measuring again what was recorded."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from hil.axis.axis_file import AxisConfig
from hil.machine.conditions import Conditions
from hil.machine.replay import recorded, replayed
from hil.machine.wiring import Machine, connected


def add_recording_options(parser: argparse.ArgumentParser) -> None:
    """`--record` and `--replay`."""
    recording = parser.add_mutually_exclusive_group()
    recording.add_argument("--record", metavar="FILE.csv", help="record drive and instrument to a new file")
    recording.add_argument("--replay", metavar="FILE.csv", help="play such a recording instead of connecting anything")


def recording_name(args: argparse.Namespace) -> str:
    """File name of what is replayed; empty where nothing is."""
    return Path(args.replay).name if args.replay else ""


@contextmanager
def machine_of(args: argparse.Namespace, axis: AxisConfig, conditions: Conditions | None = None) -> Iterator[Machine]:
    """The connected axis, recorded where that is asked for, or the axis of a recording."""
    if args.replay:
        with replayed(axis, Path(args.replay)) as machine:
            yield machine
        return
    with connected(axis, conditions=conditions) as machine, ExitStack() as stack:
        if args.record:
            stack.enter_context(recorded(machine, Path(args.record)))
        yield machine
