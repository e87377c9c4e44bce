"""A report on paper, read back by PDFium: what the page says is there, words stay inside their room, tables keep their heads."""

from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from html.parser import HTMLParser

import numpy as np
import pypdfium2 as pdfium
import pytest
from matplotlib.figure import FigureBase
from matplotlib.patches import Rectangle
from pypdfium2 import raw

from hil.correction.tables import Band
from hil.diagnosis.report.diagnosis import section
from hil.figures.uncertainty import UncertaintyInputs
from hil.records.rows import Records
from hil.ui.report.blocks import Bullets, DataTable, Drawing, Facts, Framed, Heading, ReportTable, said
from hil.ui.report.data import NamedCampaign, ReportData, TableInForce
from hil.ui.report.document import render_html
from hil.ui.report.pdf import on_paper, render_pdf, write
from hil.ui.report.svg import Ground, Theme, figure_on


def campaign(label: str, seed: int, **more: str) -> NamedCampaign:
    """Five runs over seven targets, with times and a temperature."""
    rng = np.random.default_rng(seed)
    targets = np.array([0.0, 31.0, 64.5, 99.0, 131.0, 160.0, 204.0])
    rows = [
        (run, d, p, p + (0.02 * p + d + 0.3 * rng.normal()) / 1000, 9.0 * run, 20 + 0.1 * run)
        for run in range(1, 6)
        for d in (1, -1)
        for p in targets[::d]
    ]
    names = ("run", "direction", "target_mm", "measured_mm", "time_s", "temp_screw_c")
    return NamedCampaign(label, Records.of(dict(zip(names, zip(*rows, strict=True), strict=True))), **more)


FOUND = {
    "noise_floor_um": 0.31,
    "declared": ["pitch_table"],
    "findings": [
        {
            "effect": "thermal_expansion",
            "parameters": {"alpha_ppm_k": {"value": 11.52, "std": 0.4}},
            "confidence": 0.97,
            "action": "compensate",
            "explanation": "Grows with position and temperature.",
            "rivals": [{"effect": "air_index", "confidence": 0.03, "separate_by": "vary both apart"}],
        }
    ],
    "unexplained": True,
    "carried_by": [{"columns": ["load_kg"]}],
    "blind_to": [{"effect": "abbe", "reason": "no angle was recorded"}],
    "notes": ["a note of the diagnosis"],
    "before": {"rms_um": 6.0, "peak_um": 14.0},
    "after": {"rms_um": 1.5, "peak_um": 3.0},
    "held_out": {"how": "leave-one-run-out", "rows": 70},
}


def whole() -> ReportData:
    """A report with every part there is."""
    after = campaign("as left", 2, note="all sections inside", source="after.csv", sha256="cd" * 32)
    return ReportData(
        "Axis X, 校正前 and after",
        (campaign("as found", 1, source="before.csv", sha256="ab" * 32), after),
        {"Axis": "X", "Instrument": "µMD, serial 7"},
        Band(-2.0, 2.0),
        (TableInForce("correction tables", "ef" * 32, "bidirectional, 9 positions"),),
        section(FOUND, after),
        ("coolant off",),
        "2024-03-01 10:00 UTC",
        UncertaintyInputs(device_um_per_m=0.8, variation_um=1.0),
        {"after.csv": "signed by c1a5 a980"},
        compare=True,
    )


class Words(HTMLParser):
    """What a reader sees of a page; not folded tables, the buttons, nor what is said of the file itself."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.open.append("folded" if tag == "details" and "folded" in (dict(attrs).get("class") or "") else tag)

    def handle_endtag(self, tag: str) -> None:
        while self.open.pop() not in (tag, "folded" if tag == "details" else tag):
            pass

    def handle_data(self, data: str) -> None:
        if not {"style", "script", "button", "footer", "summary", "title", "folded"} & set(self.open):
            self.found += data.split()


MM = 72 / 25.4
MARGIN_PT = 19 * MM
Box = tuple[float, float, float, float]
"""Left, bottom, right, top, in points from the lower left corner of the sheet."""


@dataclass(frozen=True)
class Sheet:
    """What a foreign reader finds: the words in their order, the boxes of its lines of text, of forms, and of what is drawn."""

    width: float
    height: float
    text: str
    lines: list[Box]
    drawn: list[Box]
    paths: list[Box]

    @property
    def words(self) -> list[str]:
        return self.text.split()


def read(file: bytes) -> list[Sheet]:
    """All sheets of a PDF. WeasyPrint makes forms of the words of a drawing that do not begin at their place."""
    document = pdfium.PdfDocument(file)
    sheets = []
    for number in range(len(document)):
        page = document[number]
        kinds = (raw.FPDF_PAGEOBJ_TEXT, raw.FPDF_PAGEOBJ_FORM, raw.FPDF_PAGEOBJ_PATH)
        boxes: dict[int, list[Box]] = {kind: [] for kind in kinds}
        for one in page.get_objects(max_depth=1):
            if one.type in boxes and (box := one.get_bounds())[2] > box[0]:
                boxes[one.type].append(box)
        text = page.get_textpage().get_text_bounded()
        sheets.append(Sheet(*page.get_size(), text, *(boxes[kind] for kind in kinds)))
    document.close()
    return sheets


def check_room(sheet: Sheet) -> None:
    """Everything stands on the sheet and between its side margins, and no line of text lies on another or on a drawing's words."""
    for index, box in enumerate([*sheet.drawn, *sheet.lines]):
        assert MARGIN_PT - 1 <= box[0] < box[2] <= sheet.width - MARGIN_PT + 1
        assert 0 <= box[1] < box[3] <= sheet.height
        if index < len(sheet.drawn):
            continue
        for other in [*sheet.drawn, *sheet.lines[: index - len(sheet.drawn)]]:
            across = min(box[2], other[2]) - max(box[0], other[0])
            down = min(box[3], other[3]) - max(box[1], other[1])
            assert across <= 1 or down <= 0.3 * min(box[3] - box[1], other[3] - other[1])


@pytest.fixture(scope="module")
def made() -> list[Sheet]:
    return read(render_pdf(whole(), "12" * 32))


@pytest.mark.outside
def test_paper_says_what_the_page_says_on_numbered_sheets(made: list[Sheet]) -> None:
    page = render_html(whole())
    printed = {word for sheet in made for word in sheet.words}
    missing = {word for word in Words(page).found if word not in printed}
    assert not missing
    assert len(set(Words(page).found)) > 200
    for number, sheet in enumerate(made, start=1):
        said = " ".join(sheet.words)
        for head in ("Axis: X · 2024-03-01 10:00 UTC", "SHA-256 " + "12" * 32, f"page {number} of {len(made)}"):
            assert head in said
        assert (sheet.width, sheet.height) == pytest.approx((210 * MM, 297 * MM), abs=0.1)  # A4


@pytest.mark.outside
def test_nothing_leaves_its_sheet_and_no_words_lie_on_others(made: list[Sheet]) -> None:
    assert sum(len(sheet.drawn) for sheet in made) > 100
    for sheet in made:
        check_room(sheet)


@pytest.mark.outside
def test_words_too_long_for_a_line_are_cut_and_lose_no_letter() -> None:
    long = "µx-" + "abcdefghij" * 25
    blocks = [
        said(long),
        said(long, "callout"),
        Heading(long, 2),
        Heading(long, 3),
        Bullets((long,)),
        Facts({"short": long}),
        ReportTable(("name", "hash"), (("a", long),), "hash"),
        ReportTable(("name", long, "b"), ((long, "1.0", long),), "meaning"),
        Framed((said(long),)),
    ]
    found = read(write(blocks, "title"))
    assert sum(sheet.text.count("j") for sheet in found) >= 11 * 25  # a head is there again on every sheet of its table
    for sheet in found:
        check_room(sheet)


def data_table(columns: int, rows: int, **more: bool) -> DataTable:
    values = {f"long_name_of_column_{n}_mm": np.arange(rows) + 1000.0 * n for n in range(columns)}
    return DataTable("data", "Data", values, **more)


@pytest.mark.outside  # thousands of rows on paper
def test_a_long_table_has_its_head_on_every_sheet_and_every_row_once() -> None:
    rows = [(f"row{n};", str(n)) for n in range(220)]
    found = read(write([ReportTable(("name", "figure"), tuple(rows), "numbers small")], "title"))
    assert len(found) >= 3
    assert all(sheet.words.count("figure") == 1 for sheet in found)
    assert [int(n) for sheet in found for n in re.findall(r"row(\d+);", sheet.text)] == list(range(220))


def test_a_table_too_wide_goes_on_below_with_the_number_of_its_rows() -> None:
    found = read(write(on_paper([data_table(12, 2, unfolded=True)]), "title"))
    words = [word for sheet in found for word in sheet.words]
    assert words.count("row") >= 2
    assert all(words.count(f"long_name_of_column_{n}_mm") == 1 for n in range(12))
    assert all(words.count(f"{1000 * n + 1}.00000") == 1 for n in range(12))
    for sheet in found:
        check_room(sheet)


def test_folded_data_stay_in_the_page_and_the_last_line_names_them() -> None:
    blocks = [Heading("Part"), Framed((Heading("Inner", 3), data_table(1, 500))), said("last words")]
    heading, finding, last, data, named = on_paper(blocks)
    assert (heading, finding, last) == (Heading("Part"), Framed((Heading("Inner", 3),)), said("last words"))
    assert data == Heading("Data")
    assert "Inner: data, 500 rows" in named.text  # type: ignore[union-attr]


def test_a_drawing_fills_the_width_in_its_own_shape_and_stays_whole() -> None:
    def draw(theme: Theme, ground: Ground) -> FigureBase:
        figure = figure_on(ground, 9.6, 4.0)
        figure.add_artist(Rectangle((0.0, 0.0), 1.0, 1.0, transform=figure.transSubfigure, facecolor=theme.up))
        return figure

    found = read(write([Drawing("one", "one", draw, "one"), Drawing("two", "two", draw, "two")], "title"))
    assert len(found) == 1
    width = 210 * MM - 2 * MARGIN_PT
    for sheet in found:
        size = pytest.approx((MARGIN_PT, width, width * 4.0 / 9.6), abs=0.5)
        whole = {box for box in sheet.paths if (box[0], box[2] - box[0], box[3] - box[1]) == size}
        assert len(whole) == 2
        assert all(box[1] >= 18 * MM - 1 for box in sheet.paths if box[3] - box[1] > 72)


@pytest.mark.outside
def test_other_processes_give_the_same_bytes() -> None:
    """Whatever order their sets have, their clock and their zone."""
    script = (
        "import hashlib; from hil.ui.report.pdf import write; from hil.ui.report.blocks import *;"
        "print(hashlib.sha256(write([Heading('µ'), said('words ↑ x̄'), Facts({'a': 'b'})], 'title')).hexdigest())"
    )
    blocks = [Heading("µ"), said("words ↑ x̄"), Facts({"a": "b"})]
    expected = hashlib.sha256(write(blocks, "title")).hexdigest()
    for seed, zone in (("1", "UTC"), ("2", "Asia/Tokyo")):
        environment = os.environ | {"PYTHONHASHSEED": seed, "TZ": zone}
        done = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == expected
