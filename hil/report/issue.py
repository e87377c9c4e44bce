"""Issues certificates: reads records or a result, writes paper and Digital Calibration Certificate, signs both."""

from __future__ import annotations

import argparse
import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from datetime import date, datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.errors import InputError
from drivers.files import read_bytes, read_text, replace_file
from hil.axis.axis_file import AxisConfig
from hil.correction.sealed import fingerprint, load_private_key, sign_detached
from hil.records.files import naming, parse_json
from hil.records.journal import BEGUN, check_as_measured, name_of, simulated
from hil.records.rows import parse_csv
from hil.ui.terminal.options import KEY
from hil.ui.terminal.output import write_json
from hil.ui.terminal.passwords import password

if TYPE_CHECKING:  # plots are slow to import
    from hil.report.certificate import Certificate, Common
    from hil.ui.report.data import NamedCampaign

_BEGUN = re.compile(rf"^# {BEGUN}(\S+?),?(?:\s|$)", re.MULTILINE)


def write_certificates(
    args: argparse.Namespace,
    axis: AxisConfig | None,
    campaigns: Sequence[NamedCampaign],
    diagnosis: Mapping[str, Any] | None,
) -> int:
    """Write what --certificate and --dcc ask for; exit status 0, or 1 where the verdict is fail.

    Raises InputError where the axis file is missing or says too little, and what the certificate raises.
    """
    from hil.report.certificate import blocks  # noqa: PLC0415  (plots are slow to import)

    if axis is None:
        raise InputError("a certificate needs --axis-file AXIS.toml, which names machine, drive and instrument")
    if not (args.certificate or args.dcc):
        raise InputError("--result is for a certificate, expected --certificate FILE.pdf or --dcc FILE.xml with it")
    made = _certificate(args, axis, campaigns, diagnosis)
    key_file = args.key or axis.store.builder_key
    usual = None if args.key else axis.store.key_password_file
    secret = getattr(args, "key_password", None)  # a script's
    if secret is None:
        secret = password(args.key_password_file, KEY, "password of the builder's key", os.environ, usual=usual)
    key = load_private_key(key_file, secret)
    signer = fingerprint(key.public_key())
    written: dict[str, bytes] = {}
    if args.certificate:
        from hil.ui.report.pdf import write  # noqa: PLC0415  (WeasyPrint is an extra and slow to import)

        under = f"Certificate {made.number}"
        written[args.certificate] = write(blocks(made, signer), made.title, under, f"certificate {made.number}")
    if args.dcc:
        from hil.report.dcc import to_xml  # noqa: PLC0415

        written[args.dcc] = to_xml(made)
    for name, content in written.items():
        replace_file(name, content)
        replace_file(f"{name}.sig", sign_detached(content, key))
        print(name)
    print(made.sentence)
    if args.json and args.out is None:
        write_json(args.json, form(made))
    return 1 if made.verdict is not None and made.verdict.value == "fail" else 0


def form(made: Certificate) -> dict[str, Any]:
    """The certificate's figures as JSON."""
    figures = [
        {
            "symbol": one.symbol,
            "value": one.value,
            "unit": one.unit,
            "U": one.expanded,
            "limit": one.limit,
            "verdict": one.verdict,
        }
        for one in made.stated
    ]
    return {
        "number": made.number,
        "kind": made.kind,
        "sentence": made.sentence,
        "verdict": made.verdict,
        "figures": figures,
    }


def _certificate(
    args: argparse.Namespace, axis: AxisConfig, campaigns: Sequence[NamedCampaign], diagnosis: Mapping[str, Any] | None
) -> Certificate:
    from hil.report import certificate  # noqa: PLC0415  (plots are slow to import)

    if args.result is not None:
        with naming(args.result):
            return certificate.of_result(_common(args, axis, [args.result]), _json(args.result))
    paths = list(args.compare or args.records)
    if diagnosis is not None:
        if len(campaigns) != 2:
            raise InputError(
                f"the certificate of a loop needs the rows before and after, {len(campaigns)} campaigns were given"
            )
        return certificate.loop(_common(args, axis, paths), campaigns[0], campaigns[-1], diagnosis)
    last = paths[-campaigns[-1].files :]
    with naming(last[-1]):
        return certificate.positioning(_common(args, axis, last), campaigns[-1])


def _common(args: argparse.Namespace, axis: AxisConfig, paths: Sequence[str]) -> Common:
    from hil.report.certificate import Common  # noqa: PLC0415
    from hil.report.job import now  # noqa: PLC0415

    names = [name_of(path) for path in paths]
    shown = names if len(set(names)) == len(names) else list(paths)
    files = {name: hashlib.sha256(read_bytes(path)).hexdigest() for name, path in zip(shown, paths, strict=True)}
    doubts = () if args.result else tuple(doubt for path in paths if (doubt := check_as_measured(path, axis.name)))
    begun, ended = _days(args.measured, paths)
    simulator = axis.drive.is_simulated or any(map(simulated, paths))
    return Common(axis, files, begun, ended, now(), args.limit, doubts, simulator)


def _days(stated: str | None, paths: Sequence[str]) -> tuple[date, date]:
    """First and last day of the measurement: as stated, else from the line `# begun …` of each file and its last time."""
    if stated is not None:
        try:
            day = date.fromisoformat(stated)
        except ValueError:
            raise InputError(f"--measured is {stated!r}, expected a date such as 2026-03-31") from None
        return day, day
    moments: list[datetime] = []
    for path in paths:
        text = read_text(path)
        match = _BEGUN.search(text)
        if match is None:
            raise InputError("does not say when it was measured; state the day with --measured YYYY-MM-DD", path=path)
        begun = datetime.fromisoformat(match[1])
        records = parse_csv(text, path)
        span = float(np.ptp(records["time_s"])) if "time_s" in records else 0.0
        moments += [begun, begun + timedelta(seconds=span if np.isfinite(span) else 0.0)]
    return min(moments).date(), max(moments).date()


def _json(path: str) -> Mapping[str, Any]:
    try:
        read = parse_json(read_text(path))
    except ValueError as error:
        raise InputError(f"is not JSON: {error}", path=path) from error
    if not isinstance(read, dict):
        raise InputError("is not a result, expected a JSON object", path=path)
    return read
