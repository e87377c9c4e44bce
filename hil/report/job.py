"""Makes reports of stored campaigns, for the command line and the screen."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

from drivers.errors import InputError
from drivers.files import read_bytes, read_text, replace_file
from hil.axis.axis_file import AxisConfig, uncertainty_of
from hil.axis.identity import identity, now_in_words
from hil.desk.worker_process import Passes, Work
from hil.diagnosis.stored import read_stored, stored_beside
from hil.figures.history import find_campaigns, history, usual_pass
from hil.records.journal import name_of, stated_targets_mm
from hil.records.rows import concatenate, parse_csv
from hil.ui.report.data import NamedCampaign, ReportData

FOLDER = "reports"
"""Name of the folder with an axis's reports, within that of its campaigns."""
HISTORY_FIGURES = ("A", "R", "B")
REPORT = Work("report", "hil.report.job:make_report")
COMPARE = Work("compare", "hil.report.job:make_comparison")
HISTORY = Work("history", "hil.report.job:make_history")
NAME = re.compile(r"(report|comparison|history)-\d+\.(html|pdf)")


def named_campaign(passes: Passes) -> NamedCampaign:
    """Read a campaign. Raises InputError naming the file."""
    records = concatenate([parse_csv(read_text(path), path) for path in passes.paths])
    if len(passes.paths) > 1:
        source, digest = f"{len(passes.paths)} files of {passes.paths[0].parent.name}", ""
    else:
        path = passes.paths[0]
        source, digest = name_of(path), hashlib.sha256(read_bytes(path)).hexdigest()
    own = tuple(target for path in passes.paths for target in stated_targets_mm(path))
    return NamedCampaign(passes.label, records, "", source, digest, files=len(passes.paths), calibrated_mm=own)


def report_data(axis: AxisConfig, campaigns: Sequence[Passes], diagnosis: Path | None, *, compare: bool) -> ReportData:
    """The contents of a report on an axis. diagnosis: file of the last campaign's diagnosis, None without one. Raises InputError."""
    from hil.diagnosis.report.diagnosis import section  # noqa: PLC0415  (plots are slow to import)

    named = tuple(map(named_campaign, campaigns))
    found = None if diagnosis is None else read_stored(diagnosis)
    return ReportData(
        f"{'Comparison of measurements' if compare else 'Positioning'} of axis {axis.name}",
        named,
        identity(axis),
        axis.correction.band,
        causes=() if found is None else section(found, named[-1]),
        compare=compare,
        band_targets_mm=axis.measurement.targets_mm,
        uncertainty=uncertainty_of(axis),
        limit_um=axis.correction.accuracy_limit_um,
        created=now_in_words(),
    )


def write_report(data: ReportData, html: Path, pdf: Path | None) -> str:
    """Write a report as an HTML page, and as a PDF unless `pdf` is None; returns the page's SHA-256, which is printed on the PDF.

    Raises InputError, with nothing written, where a PDF is asked for and its renderer is missing.
    """
    from hil.ui.report.document import render_html  # noqa: PLC0415  (plots are slow to import)

    page = render_html(data).encode("utf-8")
    digest = hashlib.sha256(page).hexdigest()
    if pdf is not None:
        write_paper(data, digest, pdf)
    replace_file(html, page)
    return digest


def write_paper(data: ReportData, page_sha256: str, pdf: Path) -> None:
    """Write the PDF of a report. page_sha256: of its HTML page. Raises InputError where the renderer is missing."""
    from hil.ui.report.pdf import render_pdf  # noqa: PLC0415  (WeasyPrint is an extra and slow to import)

    replace_file(pdf, render_pdf(data, page_sha256))


def make_report(axis: AxisConfig, campaigns: Sequence[Passes]) -> list[str]:
    """Write a report, with the stored diagnosis of the last campaign, as page and PDF into the axis's folder of reports; returns their
    file names. Raises InputError, after the page is written, where the renderer of PDFs is missing.
    """
    stored = stored_beside(campaigns[-1].paths)
    data = report_data(axis, campaigns, stored if stored.exists() else None, compare=False)
    return _page_and_paper(data, _next(axis, "report"))


def make_comparison(axis: AxisConfig, campaigns: Sequence[Passes]) -> list[str]:
    """Write a comparison of two campaigns. Otherwise as `make_report`."""
    return _page_and_paper(report_data(axis, campaigns, None, compare=True), _next(axis, "comparison"))


def _page_and_paper(data: ReportData, page: Path) -> list[str]:
    digest = write_report(data, page, None)
    write_paper(data, digest, page.with_suffix(".pdf"))
    return [page.name, page.with_suffix(".pdf").name]


def make_history(axis: AxisConfig, _campaigns: Sequence[Passes] = ()) -> list[str]:
    """Write the figures of all campaigns of the axis over time as a page; returns its file name.

    Raises InputError where no pass has all of them.
    """
    moments = history([one for one in find_campaigns([axis.store.directory]) if one.axis == axis.name], HISTORY_FIGURES)
    if not moments:
        raise InputError(f"no pass has the figures {', '.join(HISTORY_FIGURES)}", path=axis.store.directory)
    usual = usual_pass(moments)
    from hil.ui.report.history import render_history  # noqa: PLC0415  (plots are slow to import)

    page = _next(axis, "history")
    moments = [one for one in moments if one.at.name == usual]
    replace_file(page, render_history(f"Axis {axis.name} over time", moments, HISTORY_FIGURES).encode())
    return [page.name]


def _next(axis: AxisConfig, kind: str) -> Path:
    folder = axis.store.directory / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    taken = [int(path.stem.rpartition("-")[2]) for path in folder.glob("*-*.html") if NAME.fullmatch(path.name)]
    return folder / f"{kind}-{max(taken, default=0) + 1:03d}.html"
