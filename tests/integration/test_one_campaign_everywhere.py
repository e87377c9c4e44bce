"""The figures of one campaign are the same in terminal, JSON, screen, page, paper, certificate and DCC.

Another output is another entry of `READ`: a function that reads the figures back from what the output shows.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from html import unescape
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pypdfium2
import pytest
from support.bench_axis import CERTIFICATE, PASSWORDS, lay_out

from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.calibration.page_data import calibration_screen

UNCERTAINTY = "\naccuracy_limit_um = 30.0\n" + CERTIFICATE


@dataclass(frozen=True)
class Shown:
    """One campaign in all outputs. axis: the axis file; the others as the commands left them."""

    axis: Path
    terminal: str
    verified: dict[str, Any]
    verified_page: str
    report_json: dict[str, Any]
    page: str
    paper: str
    certificate: str
    dcc: str


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    place = tmp_path_factory.mktemp("everywhere")
    axis = lay_out(place, machine="typical", sections=5, runs=2, correction=UNCERTAINTY)
    with pytest.MonkeyPatch.context() as patch:
        for name, value in PASSWORDS.items():
            patch.setenv(name, value)
        patch.setenv("COLUMNS", "100")  # xdist gives 80, where names of stages wrap
        assert main(["calibrate", str(axis), "--without-proof"]) == 0
        told = place / "verify.txt"
        with told.open("w") as out:
            patch.setattr("sys.stdout", out)
            main(["verify", str(axis), "--json", str(place / "v.json"), "--report", str(place / "v.html")])
        rows = place / "X-campaign" / "verify-001" / "verify.csv"
        files = ["--out", str(place / "r.html"), "--pdf", str(place / "r.pdf"), "--json", str(place / "r.json")]
        files += ["--certificate", str(place / "c.pdf"), "--dcc", str(place / "c.xml")]
        with (place / "report.txt").open("w") as out:
            patch.setattr("sys.stdout", out)
            assert main(["report", str(rows), "--axis-file", str(axis), *files]) == 0
    return Shown(
        axis,
        told.read_text(),
        json.loads((place / "v.json").read_text()),
        (place / "v.html").read_text(),
        json.loads((place / "r.json").read_text()),
        (place / "r.html").read_text(),
        _text(place / "r.pdf"),
        _text(place / "c.pdf"),
        (place / "c.xml").read_text(encoding="utf-8"),
    )


def _text(pdf: Path) -> str:
    with pypdfium2.PdfDocument(pdf) as document:
        return "\n".join(page.get_textpage().get_text_range() for page in document)


Figures = dict[str, str]
"""By name, as shown: "A", "U(A)", … to a hundredth of a µm, and the decision."""


def _rounded(values: dict[str, Any], known: dict[str, Any]) -> Figures:
    return {name: f"{value:.2f}" for name, value in values.items()} | {
        f"U({name})": f"{value:.2f}" for name, value in known.items()
    }


def _terminal(shown: Shown) -> Figures:
    rows = re.findall(r"^ +([AEMRB][↑↓\u0304]?) +(-?[\d.]+) +([\d.]+) ", shown.terminal, re.MULTILINE)
    head = re.search(r"A = ([\d.]+) ± ([\d.]+) µm at other targets; limit 30 µm: (\w+)", shown.terminal)
    stage = re.search(r"^ +verified, other targets +\d+ +([\d.]+) +([\d.]+)", shown.terminal, re.MULTILINE)
    assert head is not None
    assert stage is not None
    table = {_name(symbol): value for symbol, value, _ in rows} | {f"U({_name(s)})": u for s, _, u in rows}
    assert (table["A"], table["U(A)"]) == (head[1], head[2]), "the sentence and the table below it"
    return {**table, "decision": head[3], "RMS": stage[1], "peak": stage[2]}


def _json(shown: Shown) -> Figures:
    form = shown.verified
    found = form["accuracy"]
    assert (found["A_um"], found["U_um"]) == (form["A_um"], form["uncertainty_um"]["A"])
    more = {"decision": found["decision"], "RMS": f"{form['rms_um']:.2f}", "peak": f"{form['peak_um']:.2f}"}
    return _rounded(form["figures_um"], form["uncertainty_um"]) | more


def _screen(shown: Shown) -> Figures:
    stage = calibration_screen(load_axis(shown.axis)).verified
    assert stage is not None
    assert stage.accuracy is not None
    assert (stage.accuracy.A_um, stage.accuracy.U_um) == (stage.figures_um["A"], stage.u95_um["A"])
    return _rounded(dict(stage.figures_um), dict(stage.u95_um)) | {"decision": stage.accuracy.decision.value}


def _report_json(shown: Shown) -> Figures:
    (form,) = shown.report_json["campaigns"]
    more = {"decision": form["accuracy"]["decision"]}
    return _rounded(form["iso230"]["figures_um"], form["uncertainty_um"]) | more


def _written(text: str, row: str) -> Figures:
    """From the table of figures and the first sentence of a report, as text; row: pattern of a row's name and cells."""
    rows = re.findall(row, text)
    figures = {_name(symbol): value for symbol, value, _ in rows} | {f"U({_name(s)})": u for s, _, u in rows}
    head = re.search(r"A = ([\d.]+) ± ([\d.]+) µm at other targets; limit 30 µm: (\w+)", text)
    spread = [re.search(rf"{name}\W+(?:</th><td>)?([\d.]+)", text) for name in ("RMS error", "largest error")]
    assert head is not None
    assert (figures["A"], figures["U(A)"]) == (head[1], head[2]), "the sentence and the table below it"
    numbers = {name: found[1] for name, found in zip(("RMS", "peak"), spread, strict=True) if found is not None}
    return {**figures, "decision": head[3], **numbers}


def _certificate(shown: Shown) -> Figures:
    rows = re.findall(r"(?m)^([AEMRB][↑↓\u0304]?) (-?[\d.]+) ([\d.]+) µm ", shown.certificate)
    head = re.search(
        r"is A = ([\d.]+) ± ([\d.]+) µm \(U, k = 2\) against a limit of 30.00 µm: (\w+)",
        " ".join(shown.certificate.split()),
    )
    assert head is not None
    figures = {_name(symbol): value for symbol, value, _ in rows} | {f"U({_name(s)})": u for s, _, u in rows}
    assert (figures["A"], figures["U(A)"]) == (head[1], head[2]), "the sentence and the table below it"
    return figures | {"decision": head[3]}


def _dcc(shown: Shown) -> Figures:
    ns = {"dcc": "https://ptb.de/dcc", "si": "https://ptb.de/si"}
    root = ElementTree.fromstring(shown.dcc)
    values, known = {}, {}
    for quantity in root.iterfind(".//dcc:quantity", ns):
        _, own, name = str(quantity.get("refType")).partition(" hil_")
        if own and quantity.find("si:real", ns) is not None:
            assert quantity.findtext("si:real/si:unit", "", ns) == r"\micro\metre"
            values[name] = float(quantity.findtext("si:real/si:value", "", ns))
            known[name] = float(quantity.findtext("si:real/si:expandedUnc/si:uncertainty", "", ns))
    return _rounded(values, known) | {"decision": root.findtext(".//dcc:conformity", "", ns)}


CELL = r'<tr><th scope="row">([AEMRB][↑↓\u0304]?)</th><td>(-?[\d.]+) ± ([\d.]+)</td>'
LINE = r"(?m)^([AEMRB][↑↓\u0304]?) (-?[\d.]+) ± ([\d.]+) "
READ: dict[str, Callable[[Shown], Figures]] = {
    "terminal": _terminal,
    "JSON of verify": _json,
    "screen": _screen,
    "page of verify": lambda shown: _written(unescape(shown.verified_page), CELL),
    "page of report": lambda shown: _written(unescape(shown.page), CELL),
    "JSON of report": _report_json,
    "paper": lambda shown: _written(shown.paper, LINE),
    "certificate": _certificate,
    "DCC": _dcc,
}
"""Output -> how its figures are read back. A new output is added here, and to `Shown` what it is read from."""


def _name(symbol: str) -> str:
    return symbol.replace("↑", "_up").replace("↓", "_down").replace("B\u0304", "B_mean")


@pytest.mark.parametrize("output", READ)
def test_every_figure_of_one_campaign_is_the_same_in_every_output(shown: Shown, output: str) -> None:
    figures, reference = READ[output](shown), _json(shown)
    assert {"A", "U(A)", "E", "R", "M", "B", "decision"} <= set(figures)
    assert set(figures) <= set(reference)
    assert {name: figures[name] for name in figures} == {name: reference[name] for name in figures}
