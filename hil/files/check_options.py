"""Options of `hil check`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_json_option

EXAMPLE = """\
example:
  hil check axis.sealed --builder builder.pub
  hil check report.html --builder builder.pub      # with report.html.sig beside it

exit code: 0 as the builder signed it, 1 not, 2 cannot be checked.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil check`."""
    parser = subparsers.add_parser(
        "check",
        description="Check a sealed file, or a file with a detached signature, against the builder's public key.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("file", metavar="FILE", help="a sealed file, or any file with a FILE.sig")
    parser.add_argument("--builder", metavar="BUILDER.pub", required=True, help="the builder's public key")
    parser.add_argument("--signature", metavar="SIG", help="the detached signature (default: FILE.sig)")
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.check"))
