"""Options of `hil open`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_json_option, add_reading_options

EXAMPLE = """\
example:
  hil open axis.sealed --builder builder.pub --entry pitch.json
  hil open axis.sealed --builder builder.pub --out unlocked/

The builder's signature is checked first; nothing is decrypted from a file that is not as the builder signed it.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil open`."""
    parser = subparsers.add_parser(
        "open",
        description="Check a sealed file and decrypt its entries, to standard output (one entry) or into a directory.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sealed", metavar="SEALED", help="the sealed file")
    parser.add_argument("--builder", metavar="BUILDER.pub", required=True, help="the builder's public key")
    parser.add_argument("--entry", metavar="NAME", action="append", help="only this entry; may be repeated")
    parser.add_argument("--out", metavar="DIR", help="write the entries as files into DIR (made if need be)")
    parser.add_argument("--force", action="store_true", help="replace files that are already in DIR")
    add_reading_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.open_"))
