"""Options of `hil seal`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_json_option, add_key_options, add_reading_options

EXAMPLE = """\
example:
  hil sign --new-key builder                                        # once: builder.key (keep it), builder.pub (goes with the machine)
  hil seal pitch.json backlash.json --out axis.sealed --key builder.key
  hil seal backlash.json --out axis.sealed --key builder.key --update --entry-password backlash.json=pw.txt

Each file becomes an entry of its own name, encrypted with its password; the builder's key signs the whole.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil seal`."""
    parser = subparsers.add_parser(
        "seal",
        description="Lock files into one sealed file that machines can run with and only the builder can change.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("files", metavar="FILE", nargs="+", help="files to seal, one entry each")
    parser.add_argument(
        "--out", metavar="SEALED", required=True, help="the sealed file; an older one is replaced in one step"
    )
    parser.add_argument(
        "--update",
        action="store_true",
        help="keep the other entries of SEALED as they are (their passwords are not needed)",
    )
    add_key_options(parser, required=True)
    add_reading_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.seal"))
