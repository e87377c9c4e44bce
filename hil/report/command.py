"""`hil report`: one self-contained HTML file from records."""

from __future__ import annotations

import argparse
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from drivers.errors import InputError
from drivers.files import decode_text, read_bytes, read_text, replace_file
from hil.axis.axis_file import AxisConfig, load_axis, uncertainty_of
from hil.axis.identity import identity, now_in_words
from hil.calibration.job import CALIBRATE, VERIFY
from hil.correction.sealed import SealedError, check, check_detached, fingerprint, is_sealed, load_public_key
from hil.correction.tables import Band
from hil.figures.history import latest_file, read_campaign, series
from hil.figures.uncertainty import Budget
from hil.records.files import parse_json
from hil.records.journal import FINISHED, name_of, stated_targets_mm
from hil.records.rows import concatenate, parse_csv
from hil.report.issue_certificate import CertificateOrder, builder_key, form, made_certificate, write_signed
from hil.report.job import write_report
from hil.ui.terminal.output import write_json

if TYPE_CHECKING:  # plots are slow to import
    from hil.ui.report.data import NamedCampaign

NOT_GOOD = "NOT GOOD: "


def signatures(paths: Sequence[str], public: Ed25519PublicKey) -> dict[str, str]:
    """File name -> result of checking its signature: the one in a sealed file, else that in FILE.sig beside it."""
    return {Path(path).name: _signature(Path(path), public) for path in paths}


def _signature(path: Path, public: Ed25519PublicKey) -> str:
    data = read_bytes(path)
    beside = path.with_name(f"{path.name}.sig")
    try:
        if is_sealed(data):
            check(data, public)
        elif beside.exists():
            check_detached(data, read_bytes(beside), public)
        else:
            return "not signed"
    except SealedError as error:
        return NOT_GOOD + error.what
    return f"signed by {fingerprint(public)}"


def run(args: argparse.Namespace) -> int:
    """Exit status 0: written; 1: written, and a signature is not good or a certificate says fail.

    Raises InputError for wrong files and arguments.
    """
    from hil.diagnosis.report.diagnosis import opening, section  # noqa: PLC0415
    from hil.ui.report.data import NamedCampaign, ReportData, TableInForce  # noqa: PLC0415  (plots are slow to import)
    from hil.ui.report.document import budgets, render_files  # noqa: PLC0415

    axis = None if args.axis_file is None else load_axis(args.axis_file)
    if args.result is not None:
        return _certify(args, axis, (), None)
    paths = _record_files(args, axis)
    labels = args.label or _default_labels(paths)
    if len(labels) != len(paths):
        raise InputError(f"{len(labels)} --label for {len(paths)} record files, expected one for each")
    if args.out is None and not (args.certificate or args.dcc):
        raise InputError("nothing to write: expected --out REPORT.html, --certificate FILE.pdf or --dcc FILE.xml")
    if args.out is None and (args.pdf or args.png):
        raise InputError("--pdf and --png are of the report, expected --out REPORT.html with them")
    signed = {} if args.builder is None else signatures([*paths, *args.table], load_public_key(args.builder))
    campaigns: list[NamedCampaign] = []
    for label, path in zip(labels, paths, strict=True):
        data = read_bytes(path)
        records, own = parse_csv(decode_text(data, path), path), stated_targets_mm(path)
        one = NamedCampaign(label, records, "", name_of(path), _sha256(data), calibrated_mm=own)
        if args.join and campaigns and campaigns[-1].label == label:
            one = _joined(campaigns.pop(), one)
        campaigns.append(one)
    diagnosis = None if args.diagnosis is None else _read_diagnosis(args.diagnosis)
    if args.out is None:
        return _certify(args, axis, campaigns, diagnosis)
    document = ReportData(
        title=args.title,
        campaigns=tuple(campaigns),
        identity=({} if axis is None else identity(axis)) | dict(_identity(line) for line in args.identity),
        band=_band(args, axis),
        band_targets_mm=() if axis is None else axis.measurement.targets_mm,
        tables=tuple(TableInForce(Path(path).name, _sha256(read_bytes(path))) for path in args.table),
        causes=() if diagnosis is None else section(diagnosis, campaigns[-1], all_plots=args.all_plots),
        notes=tuple(args.note),
        opening="" if diagnosis is None or len(campaigns) < 2 else opening(diagnosis, campaigns[0], campaigns[-1]),
        compare=args.compare is not None,
        uncertainty=None if axis is None else uncertainty_of(axis),
        limit_um=args.limit if args.limit is not None or axis is None else axis.correction.accuracy_limit_um,
        signatures=signed,
        created=now_in_words(),
    )
    failed = (args.certificate or args.dcc) and _certify(args, axis, campaigns, diagnosis)
    digest = write_report(document, Path(args.out), Path(args.pdf) if args.pdf else None)
    print(args.out)
    if args.pdf:
        print(args.pdf)
    drawings = [] if args.png is None else _write_drawings(Path(args.png), render_files(document))
    if args.json:
        figures: list[dict[str, Any]] = [
            {
                "label": campaign.label,
                "source": campaign.source,
                "sha256": campaign.sha256,
                "iso230": _plain(campaign.figures()),
            }
            for campaign in campaigns
        ]
        for form, known, campaign in zip(figures, budgets(document), campaigns, strict=True):
            form["accuracy"] = document.accuracy(campaign).as_json()
            form["uncertainty_um"] = dict(known.figures_um) if isinstance(known, Budget) else None
        result = {"report": args.out, "sha256": digest, "drawings": drawings, "campaigns": figures}
        write_json(args.json, {**result, "signatures": signed})
    bad = {name: said for name, said in signed.items() if said.startswith(NOT_GOOD)}
    for name, said in bad.items():
        print(f"{name}: signature {said}")
    return 1 if bad or failed else 0


def _certify(
    args: argparse.Namespace,
    axis: AxisConfig | None,
    campaigns: Sequence[NamedCampaign],
    diagnosis: Mapping[str, Any] | None,
) -> int:
    """Write what --certificate and --dcc ask for; exit status 1 where the verdict is fail. Raises InputError as `made_certificate`."""
    if axis is None:
        raise InputError("a certificate needs --axis-file AXIS.toml, which names machine, drive and instrument")
    if not (args.certificate or args.dcc):
        raise InputError("--result is for a certificate, expected --certificate FILE.pdf or --dcc FILE.xml with it")
    paths = [args.result] if args.result is not None else list(args.compare or args.records)
    made = made_certificate(CertificateOrder(axis, paths, campaigns, diagnosis, args.measured, args.limit))
    key = builder_key(axis, args.key, args.key_password_file)
    for name in write_signed(made, key, args.certificate, args.dcc):
        print(name)
    print(made.sentence)
    if args.json and args.out is None:
        write_json(args.json, form(made))
    return 1 if made.verdict is not None and made.verdict.value == "fail" else 0


def _joined(first: NamedCampaign, second: NamedCampaign) -> NamedCampaign:
    """Two passes of one campaign: their rows, and the names and hashes of their files side by side."""
    records = concatenate([first.records, second.records])
    source, digest = f"{first.source} {second.source}", f"{first.sha256} {second.sha256}"
    own = (*first.calibrated_mm, *second.calibrated_mm)
    return replace(first, records=records, source=source, sha256=digest, files=first.files + 1, calibrated_mm=own)


def _record_files(args: argparse.Namespace, axis: AxisConfig | None) -> list[str]:
    """The files that were named; without any, the axis's latest verification, which is said. Of an older one the latest is named."""
    if args.records and args.compare is not None:
        raise InputError("expected record files, or --compare A B, and not both")
    named = list(args.compare or args.records)
    if axis is None and not named:
        raise InputError("expected record files, or --axis-file AXIS.toml, whose latest verification is taken then")
    if axis is None:
        return named
    latest = latest_file(axis.store.directory, VERIFY, axis.name)
    if named:
        older = Path(named[-1]).resolve().parent in map(Path.resolve, series(axis.store.directory, VERIFY))
        if older and latest is not None and latest.resolve() != Path(named[-1]).resolve():
            print(f"of {name_of(named[-1])} as named; the latest verification is {name_of(latest)}")
        return named
    if latest is None:
        what = "holds no finished verification of the axis: measure with `hil verify`, or name record files"
        raise InputError(what, path=axis.store.directory)
    tables = next((path for path in series(axis.store.directory, CALIBRATE) if (path / FINISHED).exists()), None)
    if tables is not None and _begun(tables) > _begun(latest.parent):
        what = f"is older than {tables.name}: verify the present tables with `hil verify`, or name record files"
        raise InputError(what, path=latest)
    print(f"of the latest verification, {latest}")
    args.records = [str(latest)]
    return list(args.records)


def _begun(directory: Path) -> float:
    begun = read_campaign(directory).begun
    return 0.0 if begun is None else begun.timestamp()


def _band(args: argparse.Namespace, axis: AxisConfig | None) -> Band | None:
    if args.band is not None:
        return Band(*args.band)
    return None if axis is None else axis.correction.band


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


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _read_diagnosis(path: str) -> Mapping[str, Any]:
    try:
        form = parse_json(read_text(path, expected="a diagnosis (JSON)"))
    except ValueError as error:
        if isinstance(error, json.JSONDecodeError):
            raise InputError(f"is not JSON: {error.msg}", path=path, line=error.lineno) from error
        raise InputError("is not JSON", path=path) from error
    if isinstance(form, dict) and isinstance(form.get("diagnosis"), dict):  # the result of `hil close-loop --json`
        form = form["diagnosis"]
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
