"""Options of `hil sign`."""

from __future__ import annotations

import argparse

from hil.ui.terminal.options import Later, add_json_option, add_key_options

EXAMPLE = """\
example:
  hil sign --new-key builder                              # makes builder.key (password-protected) and builder.pub
  hil sign report.html --key builder.key                  # writes report.html.sig
  hil sign --accept X.toml                                # the sealed file beside this axis is the one to use
  hil sign axis.sealed --key new.key --builder old.pub    # hands a sealed file on to another key

A sealed file is signed anew only if its present signature is good, so that a file that was changed meanwhile is not signed.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil sign`."""
    parser = subparsers.add_parser(
        "sign",
        description="Sign a record, a report or a sealed file with the builder's key; or make a key pair.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "file", metavar="FILE", nargs="?", help="a sealed file (signed anew) or any other (gets a FILE.sig)"
    )
    parser.add_argument("--new-key", metavar="NAME", help="make the key pair NAME.key and NAME.pub")
    parser.add_argument(
        "--accept",
        metavar="AXIS.toml",
        help="with the builder's key of the axis file: take its sealed file, though another or a later one was used before",
    )
    parser.add_argument(
        "--builder", metavar="OLD.pub", help="whose signature a sealed file carries now (default: the key's own)"
    )
    add_key_options(parser, required=False)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.files.sign"))
