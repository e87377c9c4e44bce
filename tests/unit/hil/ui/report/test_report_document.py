"""Reports: the page stands alone, holds its data, repeats to the byte, and survives whatever it is given."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.places import SHARED_DATA as DATA

from hil.correction.tables import Band, SignedSections
from hil.diagnosis.report import diagnosis as diagnosis_part
from hil.figures import FIGURES
from hil.figures.iso230 import iso230
from hil.records.rows import Records, read_csv
from hil.ui.report.data import NamedCampaign, ReportData, TableInForce, environment, history
from hil.ui.report.document import before_after_image, content, render_files, render_html
from hil.ui.report.document import html as as_html


def section(found: dict[str, Any], diagnosed: NamedCampaign | None) -> str:
    """The part about a diagnosis, as it stands in a page, without its drawings."""
    return as_html(diagnosis_part.section(found, diagnosed), lambda _drawing: "")


def undrawn(whole: ReportData) -> Page:
    """All that a page says beside its drawings, which take the time."""
    return Page(as_html(content(whole), lambda _drawing: ""))


needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA} (set HIL_SHARED_DATA)")

VOID = {"meta", "br", "img", "link", "input", "hr"}


class Page(HTMLParser):
    """Collects what the tests ask about, and fails on tags that do not close in order."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: list[str] = []
        self.data: dict[str, Any] = {}
        self.text: list[str] = []
        self.inside: str | None = None
        self.feed(html)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.append(tag)
        if tag not in VOID:
            self.open.append(tag)
        if given.get("id"):
            self.ids.append(str(given["id"]))
        self.links += [str(given[name]) for name in ("href", "src", "xlink:href", "action", "srcset") if name in given]
        if tag == "script" and given.get("type") == "application/json":
            self.inside = str(given["id"])

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open, tag
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.inside is not None:
            self.data[self.inside] = json.loads(data)
            self.inside = None
        elif not self.open or self.open[-1] not in ("style", "script"):
            self.text.append(data)

    @property
    def words(self) -> str:
        return " ".join(" ".join(self.text).split())


def campaign_rows(seed: int = 1, scale: float = 1.0, runs: int = 5, **extra: str) -> Records:
    rng = np.random.default_rng(seed)
    targets = np.sort(rng.uniform(0, 400, 9))
    rows = []
    for run in range(1, runs + 1):
        for sign in (1, -1):
            for x in targets[::sign]:
                error_um = scale * (10 * math.sin(x / 70) + 2 * sign) + rng.normal(0, 0.3)
                rows.append((run, sign, x, x + error_um / 1000, 20.0 * len(rows), 20 + len(rows) / 50))
    names = ("run", "direction", "target_mm", "measured_mm", "time_s", "temp_screw_c")
    return Records.of(dict(zip(names, zip(*rows, strict=True), strict=True)))


def data(**changes: Any) -> ReportData:
    given: dict[str, Any] = {
        "title": "Axis X",
        "campaigns": (NamedCampaign("before", campaign_rows()), NamedCampaign("after", campaign_rows(2, 0.1))),
        "identity": {"Axis": "X", "Drive": "CiA 402, node 3"},
        "band": Band(-2.0, 2.0),
        "tables": (TableInForce("pitch", "ab" * 32, "bidirectional, 9 sections"),),
        "notes": ("lubricated before the test",),
        "created": "2024-03-01 10:00 UTC",
    }
    return ReportData(**{**given, **changes})


FOUND = {
    "noise_floor_um": 0.3,
    "declared": ["pitch_table"],
    "findings": [
        {
            "effect": "thermal_expansion",
            "parameters": {"alpha_ppm_k": {"value": 11.52, "std": 0.4}},
            "confidence": 0.97,
            "action": "compensate",
            "explanation": "grows with position and temperature",
            "rivals": [{"effect": "air_index", "confidence": 0.03, "separate_by": "vary both apart"}],
        }
    ],
    "unexplained": False,
    "before": {"rms_um": 6.0, "peak_um": 14.0},
    "after": {"rms_um": 1.5, "peak_um": 3.0},
    "held_out": {"how": "leave-one-run-out", "rows": 90},
    "seconds": 1.0,
}


@pytest.fixture(scope="module")
def whole() -> str:
    return render_html(data(causes=diagnosis_part.section(FOUND, NamedCampaign("after", campaign_rows(2, 0.1)))))


@pytest.fixture(scope="module")
def page(whole: str) -> Page:
    return Page(whole)


# the page as a file


def test_the_page_refers_to_nothing_outside_itself(whole: str, page: Page) -> None:
    assert page.links
    assert all(link.startswith(("#", "data:")) for link in page.links)
    assert not {"link", "iframe", "object", "embed", "base", "img"} & set(page.tags)
    assert all(match.startswith("#") for match in re.findall(r"url\(([^)]*)\)", whole))
    assert "://" not in whole
    assert "@import" not in whole
    assert "default-src 'none'" in whole


def test_ids_are_unique_and_every_reference_has_its_target(page: Page) -> None:
    assert len(set(page.ids)) == len(page.ids)
    assert {link[1:] for link in page.links} <= set(page.ids)


@pytest.mark.outside
def test_the_same_data_give_the_same_bytes_in_another_process() -> None:
    here = Path(__file__)
    code = (
        "import hashlib, importlib.util as u\n"
        f"s = u.spec_from_file_location('again', {str(here)!r}); m = u.module_from_spec(s); s.loader.exec_module(m)\n"
        "d = m.data(causes=m.diagnosis_part.section(m.FOUND, m.NamedCampaign('after', m.campaign_rows(2, 0.1))))\n"
        "print(hashlib.sha256(m.render_html(d).encode()).hexdigest())"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(here.parents[5]), str(here.parents[4])))}
    digests = {
        subprocess.run(
            [sys.executable, "-c", code], env={**environment, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("1", "2")
    }
    assert len(digests) == 1
    assert len(next(iter(digests)).strip()) == 64


def test_marker_colours_never_reach_the_page(whole: str) -> None:
    assert "#0a000" not in whole
    assert "var(--plot-up)" in whole
    defined = set(re.findall(r"(--[\w-]+):", whole))
    assert set(re.findall(r"var\((--[\w-]+)\)", whole)) <= defined


# what it says


def test_figures_are_those_of_the_standard(page: Page) -> None:
    before, after = iso230(campaign_rows()), iso230(campaign_rows(2, 0.1))
    for name in FIGURES:
        assert f"{getattr(before, name):.2f}" in page.words
        assert f"{getattr(after, name):.2f}" in page.words
    assert "9 targets, 5 runs" in page.words


def test_the_data_behind_the_drawings_are_in_the_page_and_whole(page: Page) -> None:
    for index, records in ((1, campaign_rows()), (2, campaign_rows(2, 0.1))):
        columns = page.data[f"data-campaign-{index}-records"]["columns"]
        for name, values in records.columns.items():
            assert columns[name] == values.tolist()
        assert columns["error_um"] == pytest.approx(records.error_um.tolist())
        targets = page.data[f"data-campaign-{index}-targets"]["columns"]
        figures = iso230(records)
        assert targets["mean_up_um"] == pytest.approx(list(figures.mean_up if figures.mean_up is not None else []))
        assert len(targets["R_um"]) == 9
    assert len(page.data["data-residual"]["columns"]["residual_um"]) == 90
    assert {"x", "direction", "residual_um", "laid_over_um"} == set(page.data["data-finding-1"]["columns"])


def test_identity_tables_notes_environment_and_diagnosis_are_there(page: Page) -> None:
    for words in (
        "CiA 402, node 3",
        "ab" * 32,
        "lubricated before the test",
        "20.00 to 21.78 °C",
        "2024-03-01 10:00 UTC",
        "thermal_expansion",
        "confidence 97.0 %",
        "compensate in the machine",
        "Rival: air_index (3.0 %)",
        "90 rows that were not fitted (leave-one-run-out)",
        "-75 %",
        "11.52",
    ):
        assert words in page.words


def test_band_tile_counts_with_the_signs_and_leaves_out_what_the_band_does_not_judge() -> None:
    records = campaign_rows(2, 0.1)
    figures = iso230(records)
    targets, middle = figures.target_mm, float(figures.target_mm[4])
    shifted = np.where((records.direction < 0) & (records.target_mm >= middle - 1.0), -50.0, 50.0)
    columns = {name: records[name] for name in records.columns}
    moved = Records.of({**columns, "measured_mm": records.measured_mm + (shifted - records.error_um) / 1000.0})
    only = (NamedCampaign("after", moved),)
    signs = (SignedSections(middle - 1.0, 1e6, 1, -1),)
    whole = data(campaigns=only, band=Band(49.0, 51.0, signs), band_targets_mm=tuple(targets.tolist()))
    assert "18 of 18" in undrawn(whole).words
    assert "13 of 18" in undrawn(data(campaigns=only, band=Band(49.0, 51.0))).words
    between = data(
        campaigns=only,
        band=Band(49.0, 51.0, signs),
        band_targets_mm=(float(targets[0]), float(targets[3]), middle + 0.5, float(targets[-1])),
    )
    assert "17 of 17 target means, 1 not judged" in undrawn(between).words


def test_hostile_text_stays_text() -> None:
    bad = "</script><script>alert(1)</script>\"'><img src=x onerror=alert(1)>&amp;"
    records = campaign_rows().with_column("</script><b>", campaign_rows().error_um)
    finding = dict.fromkeys(("effect", "action", "explanation"), bad) | {"parameters": {bad: {"value": 1}}}
    whole = data(
        title=bad,
        campaigns=(NamedCampaign(bad, records, bad, bad, bad),),
        identity={bad: bad, "Axis": bad},
        tables=(TableInForce(bad, bad, bad),),
        notes=(bad,),
        created=bad,
        causes=diagnosis_part.section(
            {"findings": [finding | {"rivals": [{"effect": bad, "separate_by": bad}]}], "notes": [bad]},
            NamedCampaign(bad, records),
        ),
    )
    page = Page(render_html(whole))
    assert not {"img", "b"} & set(page.tags)
    assert page.tags.count("script") == 1 + len(page.data)
    assert " ".join(bad.split()) in page.words


def test_one_campaign_needs_no_comparison() -> None:
    page = undrawn(data(campaigns=(NamedCampaign("alone", campaign_rows()),), band=None))
    assert "Comparison" not in page.words
    assert "as found" not in page.words
    assert "change" not in page.words


@pytest.mark.parametrize(
    ("records", "says"),
    [
        (campaign_rows(runs=1), "standard deviation is undefined"),
        (campaign_rows().where(campaign_rows().direction > 0), "direction +1 only"),
        (campaign_rows().where(np.arange(90) != 40), "No ISO 230-2 figures: target"),
        (campaign_rows().where(np.arange(90) == 40), "No ISO 230-2 figures: records hold 1 target"),
    ],
)
def test_campaigns_short_of_the_standard_are_shown_and_say_so(records: Records, says: str) -> None:
    page = undrawn(data(campaigns=(NamedCampaign("short", records),), band=None))
    assert says in page.words
    assert len(page.data["data-campaign-1-records"]["columns"]["run"]) == len(records)


def test_gaps_in_optional_columns_become_null_and_empty() -> None:
    records = campaign_rows()
    load = np.where(np.arange(90) % 2 == 0, 5.0, np.nan)
    page = undrawn(data(campaigns=(NamedCampaign("gaps", records.with_column("load_kg", load)),)))
    assert page.data["data-campaign-1-records"]["columns"]["load_kg"][:2] == [5, None]


def test_long_records_are_cut_in_the_table_and_whole_in_the_data() -> None:
    rng = np.random.default_rng(0)
    n = 5200
    x = rng.uniform(0, 300, n)
    columns = {"run": np.ones(n), "direction": np.where(x > 150, 1.0, -1.0), "target_mm": x, "measured_mm": x + 1e-3}
    html = render_html(data(campaigns=(NamedCampaign("sweep", Records.of(columns)),), band=None))
    page = Page(html)
    assert "The first 2000 of 5200 rows" in page.words
    assert len(page.data["data-campaign-1-records"]["columns"]["run"]) == n
    assert "data:image/png;base64," in html


# diagnosis


ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=4),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner, max_size=3),
    max_leaves=6,
)
FINDING = st.fixed_dictionaries(
    {},
    optional=dict.fromkeys(("action", "confidence", "explanation", "parameters", "rivals", "plot"), ANY_JSON)
    | {"effect": st.sampled_from(["cyclic", "local_wear"]) | ANY_JSON},
)


@given(
    found=st.fixed_dictionaries(
        {"findings": st.lists(FINDING | ANY_JSON, max_size=2)},
        optional=dict.fromkeys(
            [*FOUND.keys() - {"findings"}, "notes", "blind_to", "carried_by", "left", "non_parametric"], ANY_JSON
        ),
    )
)
@settings(max_examples=40)
def test_any_json_in_a_diagnosis_makes_a_page(found: dict[str, Any]) -> None:
    for diagnosed in (None, NamedCampaign("after", campaign_rows())):
        Page(section(found, diagnosed))
    Page(as_html(diagnosis_part.section(found, None)))  # drawn


def test_what_is_no_text_becomes_a_mark() -> None:
    bad = "\ud800\x00\x1b"
    campaigns = (NamedCampaign(bad, campaign_rows()), NamedCampaign("b", campaign_rows()))
    finding = own_plot(column=bad, unit=bad) | {"effect": bad}
    html = render_html(
        data(campaigns=campaigns, notes=(bad,), causes=diagnosis_part.section({"findings": [finding]}, None))
    )
    assert html.encode("utf-8").count("\ufffd".encode()) > 9


def test_nothing_found_and_unexplained_are_said_plainly() -> None:
    clean = Page(section({"findings": [], "unexplained": False}, None)).words
    assert "No effect was found beyond the declared model" in clean
    left = {"findings": [], "unexplained": True, "carried_by": [{"columns": ["time_s", "load_kg"]}]}
    words = Page(section(left, None)).words
    assert "Structure is left that nothing in the catalogue explains. It shows along: time_s, load_kg." in words
    assert "No effect was found" not in words


@pytest.mark.parametrize(
    ("effect", "label"),
    [
        ("cyclic", "Position within one period of 10 mm, mm"),
        ("thermal_expansion", "Temp screw, °C"),
        ("datum_step", "Time, s"),
        ("velocity_lag", "Velocity, mm/s"),
        ("load_deflection", "Load, kg"),
        ("cross_axis", "Pos y, mm"),
        ("lost_motion", "Since reversal, mm"),
        ("local_wear", None),
        ("abbe", None),
    ],
)
def test_each_effect_is_shown_along_its_own_column(effect: str, label: str | None) -> None:
    records = campaign_rows()
    for index, name in enumerate(("velocity_mm_s", "load_kg", "pos_y_mm", "since_reversal_mm")):
        records = records.with_column(name, np.random.default_rng(index).uniform(1, 9, 90))
    found = {"findings": [{"effect": effect, "parameters": {"period_mm": {"value": 10.0, "std": 0.1}}}]}
    page = Page(section(found, NamedCampaign("after", records)))
    assert ("data-finding-1" in page.data) == (label is not None)
    if label is not None:
        assert f"(x is {label})" in page.words


def test_the_effect_is_laid_over_where_the_records_have_it_and_the_mean_elsewhere() -> None:
    effect = np.linspace(-1, 1, 90)
    records = campaign_rows().with_column("residual_um", effect + 0.1)
    plain = Page(section(FOUND, NamedCampaign("after", records)))
    assert "laid over: mean along this column" in plain.words
    own = records.with_column("effect_thermal_expansion_um", effect)
    page = Page(section(FOUND, NamedCampaign("after", own)))
    assert "laid over: thermal_expansion" in page.words
    assert page.data["data-finding-1"]["columns"]["laid_over_um"] == pytest.approx(effect.tolist())
    assert page.data["data-finding-1"]["columns"]["residual_um"] == pytest.approx((effect + 0.1).tolist())


def test_no_confidence_is_rounded_to_certainty() -> None:
    rivals = [{"effect": "a", "confidence": 0.0001}, {"effect": "b", "confidence": 0.034}]
    words = Page(section({"findings": [{"effect": "cyclic", "confidence": 0.99999, "rivals": rivals}]}, None)).words
    assert "confidence above 99.9 %" in words
    assert "a (below 0.1 %)" in words
    assert "b (3.4 %)" in words


def own_plot(**changes: Any) -> dict[str, Any]:
    plot = {
        "column": "temp_screw_c",
        "unit": "°C",
        "x": [20.0, 21, 22],
        "residual_um": [1, 2, 3],
        "effect_um": [1.1, 2, 2.9],
    }
    return {"effect": "thermal_expansion", "plot": {**plot, **changes}}


def test_a_findings_own_plot_is_drawn_even_without_records() -> None:
    page = Page(section({"findings": [own_plot()]}, None))
    columns = page.data["data-finding-1"]["columns"]
    assert columns == {
        "x": [20, 21, 22],
        "direction": [1, 1, 1],
        "residual_um": [1, 2, 3],
        "laid_over_um": [1.1, 2, 2.9],
    }
    assert (
        "Residual without the other effects found against temp screw, °C; laid over: thermal_expansion." in page.words
    )


def test_a_cyclic_findings_own_plot_is_folded_to_its_period() -> None:
    finding = own_plot(column="target_mm", x=[1.0, 12.0, 23.0]) | {"effect": "cyclic"}
    page = Page(section({"findings": [finding | {"parameters": {"period_mm": {"value": 10.0}}}]}, None))
    assert page.data["data-finding-1"]["columns"]["x"] == [1, 2, 3]


def test_own_plots_of_the_diagnosed_rows_add_up_over_the_position() -> None:
    records = campaign_rows().with_column("residual_um", np.linspace(0, 1, 90))
    rows: dict[str, Any] = {"x": [0.5 * i for i in range(90)], "residual_um": [0.0] * 90}
    findings = [own_plot(**rows, effect_um=[0.25 * i for i in range(90)]), own_plot(**rows, effect_um=[1.0] * 90)]
    page = Page(section({"findings": findings}, NamedCampaign("diagnosed", records)))
    assert "laid over: effects found" in page.words
    assert page.data["data-residual"]["columns"]["laid_over_um"] == [1 + 0.25 * i for i in range(90)]
    assert page.data["data-finding-2"]["columns"]["direction"] == records.direction.tolist()


@pytest.mark.parametrize(
    "changes",
    [
        {"x": [1, 2]},
        {"x": None},
        {"x": []},
        {"effect_um": [1, None, 3]},
        {"residual_um": "123"},
        {"effect_um": [float("nan")] * 3},
        {"x": [[1], [2], [3]]},
        {"x": [1, 2, 10**400]},
        {"x": [{"value": 1}, 2, 3], "effect_um": [True, 2, 3]},
    ],
)
def test_a_plot_that_cannot_be_drawn_is_left_out(changes: dict[str, Any]) -> None:
    page = Page(section({"findings": [own_plot(**changes)]}, None))
    assert page.data == {}
    assert "thermal_expansion" in page.words


# data


@needs_data
def test_history_shows_the_published_drift_of_the_run_means() -> None:
    records = read_csv(DATA / "stage_b02_x.csv")
    along = history(records)
    means = [along.deviation_um[records.run == run].mean() for run in records.runs]
    assert [f"{mean:.1f}" for mean in means] == ["3.2", "1.4", "-0.6", "-1.5", "-2.5"]
    assert (along.timed, along.unit) == (False, "row")


def test_history_uses_time_where_it_is_whole() -> None:
    timed = history(campaign_rows())
    assert (timed.timed, timed.unit) == (True, "min")
    assert timed.x[-1] == pytest.approx(89 * 20 / 60)
    gap = campaign_rows().with_column("time_s", np.where(np.arange(90) == 3, np.nan, campaign_rows()["time_s"]))
    assert not history(gap).timed


def test_environment_states_ranges_and_skips_what_was_never_measured() -> None:
    records = campaign_rows().with_column("air_pressure_hpa", np.full(90, 1013.25))
    records = records.with_column("air_humidity_percent", np.full(90, np.nan))
    assert environment(records) == {"Air pressure": "1013.25 hPa", "Temperature, screw": "20.00 to 21.78 °C"}


# files of their own


def test_drawings_as_files() -> None:
    whole = data(causes=diagnosis_part.section(FOUND, NamedCampaign("after", campaign_rows(2, 0.1))))
    drawings = render_files(whole)
    assert list(drawings) == [
        "before-after.png",
        "campaign-1-error.png",
        "campaign-1-time.png",
        "campaign-2-error.png",
        "campaign-2-time.png",
        "residual.png",
        "finding-1.png",
    ]
    for drawn in drawings.values():
        assert drawn.startswith(b"\x89PNG\r\n\x1a\n")
        assert int.from_bytes(drawn[16:20], "big") > 1200


def test_the_comparison_alone() -> None:
    assert before_after_image(data().campaigns).startswith(b"\x89PNG")


# seen by people
