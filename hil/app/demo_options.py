"""Options of `hil demo`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_json_option, seed

EXAMPLE = """\
example:
  hil demo
  hil demo --out /tmp/demo --seed 7     another machine

A CiA-402 drive on a virtual CAN bus and a laser on a pseudo-terminal, over a simulated screw axis. It is calibrated cold; warm, it
shows an error that no table holds. The loop finds its cause, adds it to the correction, and measures again.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil demo`."""
    parser = subparsers.add_parser(
        "demo",
        description="Calibrate, verify, diagnose, extend and verify again, on a simulated machine over real protocols.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", metavar="DIR", default="hil-demo", help="where to put everything (default hil-demo)")
    parser.add_argument("--seed", type=seed, help="another simulated machine")
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.app.demo"))
