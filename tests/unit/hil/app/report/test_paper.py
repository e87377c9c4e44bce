"""A report on paper: what the page says is there, words stay inside their room, tables keep their heads."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text

from hil.app.report.data import NamedCampaign, ReportData, TableInForce
from hil.app.report.document import render_html
from hil.app.report.paper import BODY, HEIGHT_IN, LEFT_IN, ROOM_IN, SMALL, WIDTH_IN, Column, Paper
from hil.app.report.pdf import render_pdf, sheets
from hil.app.report.svg import drawing_settings
from hil.app.report.typeset import groups, shared, wrapped
from hil.figures.uncertainty import UncertaintyInputs
from hil.records.rows import Records


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
        (-2.0, 2.0),
        (TableInForce("correction tables", "ef" * 32, "bidirectional, 9 positions"),),
        FOUND,
        after,
        ("coolant off",),
        "2024-03-01 10:00 UTC",
        UncertaintyInputs(device_um_per_m=0.8, variation_um=1.0),
        {"after.csv": "signed by c1a5 a980"},
        compare=True,
    )


class Words(HTMLParser):
    """What a reader sees of a page, folded tables too; not the buttons, nor what is said of the file itself."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self.open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if not {"style", "script", "button", "footer", "summary", "title"} & set(self.open):
            self.found += data.split()


@pytest.fixture(scope="module")
def made() -> list[Figure]:
    """The sheets of the whole report, drawn: a drawing knows the numbers of its axes only then."""
    with drawing_settings():
        found = sheets(whole(), "12" * 32).sheets
        for sheet in found:
            FigureCanvasAgg(sheet).draw()
    return found


def texts(sheet: Figure) -> Iterator[Text]:
    for one in sheet.findobj(Text):
        assert isinstance(one, Text)
        if one.get_text().strip() and one.get_visible():
            yield one


@pytest.mark.slow
def test_paper_says_what_the_page_says_on_numbered_sheets(made: list[Figure]) -> None:
    page = render_html(whole())
    words = [[word for one in texts(sheet) for word in one.get_text().split()] for sheet in made]
    printed = {word for sheet in words for word in sheet}
    missing = {word for word in Words(page).found if word not in printed}
    assert not missing
    assert len(set(Words(page).found)) > 500
    for number, sheet in enumerate(words, start=1):
        said = " ".join(sheet)
        for head in ("Axis: X · 2024-03-01 10:00 UTC", "SHA-256 " + "12" * 32, f"page {number} of {len(made)}"):
            assert head in said
    file = render_pdf(whole(), "12" * 32)
    assert len(re.findall(rb"/Type /Page\b", file)) == len(made)
    assert set(re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+)", file)) == {(b"841.68", b"595.44")}  # A4


@pytest.mark.slow
def test_nothing_leaves_its_sheet_and_no_words_lie_on_others(made: list[Figure]) -> None:
    with drawing_settings():
        for sheet in made:
            renderer = FigureCanvasAgg(sheet).get_renderer()
            width, height = sheet.bbox.width, sheet.bbox.height
            words = [one.get_window_extent(renderer) for one in sheet.texts]
            drawn = [part.bbox for part in sheet.subfigs]
            for index, box in enumerate(words):
                assert 0 <= box.x0 < box.x1 <= width
                assert 0 <= box.y0 < box.y1 <= height
                for other in [*words[:index], *drawn]:
                    across = min(box.x1, other.x1) - max(box.x0, other.x0)
                    down = min(box.y1, other.y1) - max(box.y0, other.y0)
                    assert across <= 1 or down <= 0.3 * min(box.height, other.height)


@settings(max_examples=30, deadline=None)
@given(st.text("ab .µ-", max_size=80), st.floats(0.3, 4.0))
def test_lines_keep_their_width_and_lose_no_letter(text: str, width_in: float) -> None:
    lines = wrapped(text, BODY, width_in)
    assert "".join("".join(lines).split()) == "".join(text.split())
    assert all(BODY.width_in(line) <= width_in for line in lines)


def test_columns_share_what_there_is() -> None:
    assert shared([1.0, 2.0], 5.0) == [1.0, 2.0]
    assert shared([1.0, 6.0, 5.0], 7.0) == [1.0, 3.0, 3.0]
    assert shared([4.0, 4.0], 2.0) == [1.0, 1.0]
    assert groups([1.0, 2.0, 2.0, 2.0], 5.0) == [[0, 1, 2], [0, 3]]
    assert groups([1.0], 5.0) == [[0]]
    assert groups([1.0, 9.0, 1.0], 5.0) == [[0, 1], [0, 2]]


def test_a_long_table_has_its_head_on_every_sheet_and_every_row_once() -> None:
    with drawing_settings():
        paper = Paper()
        paper.table([Column("name"), Column("figure", SMALL, right=True)], [(f"row{n}", str(n)) for n in range(120)])
        found = [[one.get_text() for one in sheet.texts] for sheet in paper.sheets]
    assert len(found) >= 3
    assert all(sheet[:2] == ["name", "figure"] for sheet in found)
    assert [word for sheet in found for word in sheet if word.startswith("row")] == [f"row{n}" for n in range(120)]


def test_a_table_too_wide_goes_on_below_with_its_first_column() -> None:
    heads = ["row", *(f"a_long_name_of_column_{n}_mm" for n in range(9))]
    with drawing_settings():
        paper = Paper()
        paper.table([Column(head, SMALL) for head in heads], [tuple(map(str, range(10)))], wrap=False)
        found = [one.get_text() for one in paper.sheets[0].texts]
    assert found.count("row") >= 2
    assert all(found.count(head) == 1 for head in heads[1:])


def test_a_drawing_has_the_size_it_asked_for_where_there_is_room() -> None:
    with drawing_settings():
        paper = Paper()
        boxes = [paper.ground(9.6, 4.0).bbox for _ in range(2)]
    assert len(paper.sheets) == 2
    for box in boxes:
        inch = paper.sheets[0].dpi
        assert (box.width / inch, box.height / inch) == pytest.approx((9.6, 4.0), abs=1e-6)
        assert box.x0 / inch == pytest.approx(LEFT_IN)
        assert box.x1 / inch <= LEFT_IN + ROOM_IN <= WIDTH_IN
        assert box.y1 / inch < HEIGHT_IN
