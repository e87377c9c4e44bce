"""`hil report`: one HTML file from records, for people and for the archive."""

from __future__ import annotations

import argparse
import datetime
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from hil.cli.output import add_json_option, write_json
from hil.files import read_bytes, replace_file
from hil.records import parse_csv

EXAMPLE = """\
example:
  hil report records.csv --out report.html
  hil report before.csv after.csv --label before --label "after calibration" --identity Axis=X --out report.html
  hil report left.csv --diagnosis found.json --out report.html --png plots/

The file stands alone: it can be mailed, archived, printed, and signed with `hil sign report.html --key builder.key`.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    parser = subparsers.add_parser(
        "report",
        help="one HTML file from records: plots, ISO 230-2 figures, data",
        description="Write one self-contained HTML file: error plots, ISO 230-2 figures, before and after, and the data behind.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "records", metavar="RECORDS.csv", nargs="+", help="record files in the order of time, one campaign each"
    )
    parser.add_argument("--out", metavar="REPORT.html", required=True, help="the report; an older one is replaced")
    parser.add_argument(
        "--label", metavar="TEXT", action="append", help="name of a campaign, once per file (default: file names)"
    )
    parser.add_argument("--title", metavar="TEXT", default="Positioning of a linear axis", help="title of the report")
    parser.add_argument(
        "--identity",
        metavar="NAME=TEXT",
        action="append",
        default=[],
        help="a line of identity, as Axis=X; may be repeated",
    )
    parser.add_argument("--band", metavar=("LOW", "HIGH"), nargs=2, type=float, help="specified accuracy band in µm")
    parser.add_argument(
        "--diagnosis", metavar="OUT.json", help="result of `hil diagnose --json` on the last of the files"
    )
    parser.add_argument(
        "--table", metavar="FILE", action="append", default=[], help="a table in force, named with its hash"
    )
    parser.add_argument("--note", metavar="TEXT", action="append", default=[], help="a remark; may be repeated")
    parser.add_argument("--png", metavar="DIR", help="also write every drawing as a PNG into DIR (made if need be)")
    add_json_option(parser)
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Write the report. Raises InputError for bad files and arguments."""
    from hil.report.data import NamedCampaign, ReportData, TableInForce  # noqa: PLC0415  (only now: plots are slow to import)
    from hil.report.document import render_files, render_html  # noqa: PLC0415

    labels = args.label or _default_labels(args.records)
    if len(labels) != len(args.records):
        raise InputError(f"{len(labels)} --label for {len(args.records)} record files, expected one for each")
    campaigns = []
    for label, path in zip(labels, args.records, strict=True):
        data = read_bytes(path)
        campaigns.append(NamedCampaign(label, parse_csv(_text(data, path), path), "", Path(path).name, _sha256(data)))
    diagnosis = None if args.diagnosis is None else _read_diagnosis(args.diagnosis)
    document = ReportData(
        title=args.title,
        campaigns=tuple(campaigns),
        identity=dict(_identity(line) for line in args.identity),
        band_um=None if args.band is None else (args.band[0], args.band[1]),
        tables=tuple(TableInForce(Path(path).name, _sha256(read_bytes(path))) for path in args.table),
        diagnosis=diagnosis,
        diagnosed=None if diagnosis is None else campaigns[-1],
        notes=tuple(args.note),
        created=datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
    )
    page = render_html(document).encode("utf-8")
    replace_file(args.out, page)
    print(args.out)
    drawings = [] if args.png is None else _write_drawings(Path(args.png), render_files(document))
    if args.json:
        figures = [
            {
                "label": campaign.label,
                "source": campaign.source,
                "sha256": campaign.sha256,
                "iso230": _plain(campaign.figures()),
            }
            for campaign in campaigns
        ]
        write_json(args.json, {"report": args.out, "sha256": _sha256(page), "drawings": drawings, "campaigns": figures})
    return 0


def _plain(figures: Any) -> Any:
    return {"missing": figures} if isinstance(figures, str) else figures.as_json()


def _default_labels(paths: list[str]) -> list[str]:
    stems = [Path(path).stem for path in paths]
    return stems if len(set(stems)) == len(stems) else list(paths)


def _identity(line: str) -> tuple[str, str]:
    name, separator, value = line.partition("=")
    if not separator or not name.strip() or not value.strip():
        raise InputError(f"--identity is {line!r}, expected NAME=TEXT")
    return name.strip(), value.strip()


def _text(data: bytes, path: str) -> str:
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError("is not UTF-8 text", path=path) from error


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _read_diagnosis(path: str) -> Mapping[str, Any]:
    try:
        form = json.loads(_text(read_bytes(path), path))
    except (ValueError, RecursionError) as error:
        if isinstance(error, json.JSONDecodeError):
            raise InputError(f"is not JSON: {error.msg}", path=path, line=error.lineno) from error
        raise InputError("is not JSON", path=path) from error
    if not isinstance(form, dict) or not isinstance(form.get("findings"), list):
        raise InputError("is not a diagnosis, expected a JSON object with a list of findings", path=path)
    return form


def _write_drawings(directory: Path, drawings: Mapping[str, bytes]) -> list[str]:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made a directory: {error.strerror}", path=directory) from error
    for name, content in drawings.items():
        replace_file(directory / name, content)
        print(directory / name)
    return [str(directory / name) for name in drawings]
