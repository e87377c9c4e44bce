"""Certificates made of records or of a result, and written as paper and as Digital Calibration Certificate, both signed."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, timedelta
from typing import TYPE_CHECKING, Any

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from drivers.errors import InputError
from drivers.files import read_bytes, read_text, replace_file
from hil.axis.axis_file import AxisConfig
from hil.correction.sealed import fingerprint, load_private_key, sign_detached
from hil.records.files import naming, parse_json
from hil.records.journal import BEGUN, check_as_measured, name_of, simulated
from hil.records.rows import parse_csv
from hil.ui.terminal.options import KEY
from hil.ui.terminal.passwords import password

if TYPE_CHECKING:  # plots are slow to import
    from hil.report.certificate import Certificate, Common
    from hil.ui.report.data import NamedCampaign

_BEGUN = re.compile(rf"^# {BEGUN}(\S+?),?(?:\s|$)", re.MULTILINE)


@dataclass(frozen=True)
class CertificateOrder:
    """What a certificate is made of.

    paths: files of the rows, or of a result; campaigns: the rows, none for a result; diagnosis: of a loop, which has two campaigns
    measured: day of the measurement, where the files do not say it; limit_um: in place of the axis file's
    """

    axis: AxisConfig
    paths: Sequence[str]
    campaigns: Sequence[NamedCampaign] = ()
    diagnosis: Mapping[str, Any] | None = None
    measured: str | None = None
    limit_um: float | None = None


def builder_key(
    axis: AxisConfig, file: str | None = None, password_file: str | None = None, given: str | None = None
) -> Ed25519PrivateKey:
    """The signing key. file: in place of the axis file's; given: its password, None: of a file, the environment or the keyboard."""
    usual = None if file else axis.store.key_password_file
    what = "password of the builder's key"
    secret = password(password_file, KEY, what, os.environ, usual=usual) if given is None else given
    return load_private_key(file or axis.store.builder_key, secret)


def write_signed(made: Certificate, key: Ed25519PrivateKey, pdf: str | None, dcc: str | None = None) -> list[str]:
    """Write a certificate as PDF and as DCC, each with its signature beside it; the names written."""
    from hil.report.certificate import blocks  # noqa: PLC0415  (plots are slow to import)

    written: dict[str, bytes] = {}
    if pdf:
        from hil.ui.report.pdf import write  # noqa: PLC0415  (WeasyPrint is an extra and slow to import)

        signer, under = fingerprint(key.public_key()), f"Certificate {made.number}"
        written[pdf] = write(blocks(made, signer), made.title, under, f"certificate {made.number}")
    if dcc:
        from hil.report.dcc import to_xml  # noqa: PLC0415

        written[dcc] = to_xml(made)
    for name, content in written.items():
        replace_file(name, content)
        replace_file(f"{name}.sig", sign_detached(content, key))
    return list(written)


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


def made_certificate(order: CertificateOrder) -> Certificate:
    """The certificate. Raises InputError for rows or a result that cannot be certified, and for an axis file that says too little."""
    from hil.report import certificate  # noqa: PLC0415  (plots are slow to import)

    paths, campaigns = order.paths, order.campaigns
    if not campaigns:
        (path,) = paths
        with naming(path):
            return certificate.of_result(_common(order, paths), _json(path))
    if order.diagnosis is not None:
        if len(campaigns) != 2:
            raise InputError(
                f"the certificate of a loop needs the rows before and after, {len(campaigns)} campaigns were given"
            )
        return certificate.loop(_common(order, paths), campaigns[0], campaigns[-1], order.diagnosis)
    last = paths[-campaigns[-1].files :]
    with naming(last[-1]):
        return certificate.positioning(_common(order, last), campaigns[-1])


def _common(order: CertificateOrder, paths: Sequence[str]) -> Common:
    from hil.axis.identity import now_in_words  # noqa: PLC0415
    from hil.report.certificate import Common  # noqa: PLC0415

    axis, names = order.axis, [name_of(path) for path in paths]
    shown = names if len(set(names)) == len(names) else list(paths)
    files = {name: hashlib.sha256(read_bytes(path)).hexdigest() for name, path in zip(shown, paths, strict=True)}
    rows = paths if order.campaigns else ()
    doubts = tuple(doubt for path in rows if (doubt := check_as_measured(path, axis.name)))
    begun, ended = _days(order.measured, paths)
    simulator = axis.drive.is_simulated or any(map(simulated, paths))
    return Common(axis, files, begun, ended, now_in_words(), order.limit_um, doubts, simulator)


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
