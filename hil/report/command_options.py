"""Options of `hil report`."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

from hil.ui.terminal.options import KEY, Later, Subparsers, add_json_option, add_limit_option, verb_parser

EXAMPLE = """\
example:
  hil report records.csv --out report.html
  hil report before.csv after.csv --label before --label "after calibration" --identity Axis=X --out report.html
  hil report left.csv --diagnosis found.json --out report.html --png plots/ --pdf report.pdf
  hil report --axis-file X.toml --out report.html                                 # of the latest verification
  hil report --axis-file X.toml --certificate X.pdf --dcc X.xml                   # signed; `hil check X.pdf --builder builder.pub`
  hil report --compare spring.csv autumn.csv --axis-file X.toml --builder builder.pub --out compared.html

The file stands alone: it can be mailed, archived, printed, and signed with `hil sign report.html --key builder.key`.
"""


def add_parser(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "report",
        "Write one self-contained HTML file: error plots, ISO 230-2 figures, before and after, and the data behind.",
        EXAMPLE,
    )
    parser.add_argument(
        "records",
        metavar="RECORDS.csv",
        nargs="*",
        help="record files in the order of time, one campaign each (default: the latest verification of --axis-file)",
    )
    parser.add_argument("--compare", metavar=("A", "B"), nargs=2, help="two record files, set against each other")
    parser.add_argument(
        "--out",
        metavar="REPORT.html",
        help="the report; an older one is replaced (needed unless --certificate or --dcc is given)",
    )
    parser.add_argument(
        "--label", metavar="TEXT", action="append", help="name of a campaign, once per file (default: file names)"
    )
    parser.add_argument(
        "--join", action="store_true", help="files in a row with one --label are passes of one campaign"
    )
    parser.add_argument("--title", metavar="TEXT", default="Positioning of a linear axis", help="title of the report")
    parser.add_argument(
        "--identity",
        metavar="NAME=TEXT",
        action="append",
        default=[],
        help="a line of identity, as Axis=X; may be repeated",
    )
    add_limit_option(parser)
    parser.add_argument("--band", metavar=("LOW", "HIGH"), nargs=2, type=float, help="specified accuracy band in µm")
    parser.add_argument(
        "--diagnosis", metavar="OUT.json", help="result of `hil diagnose --json` on the last of the files"
    )
    parser.add_argument(
        "--all-plots",
        action="store_true",
        help="draw what the extended model leaves, along every column and as a spectrum, even where nothing is unexplained",
    )
    parser.add_argument(
        "--table", metavar="FILE", action="append", default=[], help="a table in force, named with its hash"
    )
    parser.add_argument("--note", metavar="TEXT", action="append", default=[], help="a remark; may be repeated")
    parser.add_argument(
        "--axis-file",
        metavar="AXIS.toml",
        help="identity of axis, drive and instrument, band and uncertainty from an axis file",
    )
    parser.add_argument(
        "--builder",
        metavar="BUILDER.pub",
        help="whose signatures of the files to show; exit status 1 for one that is not good",
    )
    parser.add_argument(
        "--pdf",
        metavar="FILE.pdf",
        type=partial(ending, ".pdf"),
        help="also write it as a PDF: all of it, on numbered A4 sheets that name the hash of the HTML file"
        " (needs the report-pdf extra: pip install 'hil[report-pdf]')",
    )
    parser.add_argument("--png", metavar="DIR", help="also write every drawing as a PNG into DIR (made if need be)")
    _add_certificate_options(parser)
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.report.command"))


def _add_certificate_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group(
        "certificates (with --axis-file, whose [certificate] names machine, drive, instrument, parties)"
    )
    group.add_argument(
        "--certificate",
        metavar="FILE.pdf",
        type=partial(ending, ".pdf"),
        help="write a signed certificate of the last campaign, FILE.pdf and FILE.pdf.sig",
    )
    group.add_argument(
        "--dcc",
        metavar="FILE.xml",
        type=partial(ending, ".xml"),
        help="write it as a Digital Calibration Certificate (PTB's DCC 3), FILE.xml and FILE.xml.sig",
    )
    group.add_argument(
        "--result",
        metavar="OUT.json",
        help="instead of records: the result of `hil circle --json` or `hil probe measure --json`",
    )
    group.add_argument("--measured", metavar="YYYY-MM-DD", help="day of the measurement, where the files do not say it")
    group.add_argument(
        "--key", metavar="BUILDER.key", help="the builder's private key (default: builder_key of the axis file)"
    )
    group.add_argument(
        "--key-password-file",
        metavar="F",
        help=f"file whose first line is the key's password (else ${KEY}, else key_password_file of the axis file, else asked)",
    )


def ending(suffix: str, name: str) -> str:
    """The name of a file of one kind, as the type of an option."""
    if Path(name).suffix.lower() != suffix:
        raise argparse.ArgumentTypeError(f"is {name!r}, expected a name ending in {suffix}")
    return name
