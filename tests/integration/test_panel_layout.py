"""Every page, in German at three sizes and in the other languages at the smallest: nothing overlaps, is cut or leaves its card; a job
is seen as a whole."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest
from support import panel
from support.campaigns import campaign
from support.panel import Person
from support.screenshots import DEFECTS, OUT_OF_SIGHT, PALE, at_rest, foreign_fonts, settled
from support.two_axes import lay_out_axes

from hil.records.rows import to_csv
from hil.ui.screen.texts import load

pytestmark = panel.MARKS
EXAMPLES = Path(__file__).parents[2] / "hil" / "examples"
SIZES = ((1366, 768), (1920, 1080), (1024, 768))
SMALLEST = SIZES[2]
PAGES = ("overview", "axes", "calibrate", "backlash", "lost_motion", "probe", "diagnosis", "parameters", "reports")
BAR = ("stop", "chip.X", "header.job", "control.release", "events.open", "language", "looks")
ESSENTIAL = {
    "overview": ("overview.position", "overview.state", "plot.overview", "overview.power_off", "overview.reset_fault"),
    "calibrate": (
        "calibrate.steps",
        "calibrate.verified",
        "calibrate.step",
        "calibrate.progress",
        "calibrate.start",
        "calibrate.verify",
    ),
    "backlash": (
        "backlash.mean",
        "backlash.step",
        "backlash.plot",
        "backlash.start",
        "backlash.write",
        "backlash.restore",
    ),
    "lost_motion": (
        "lost_motion.amount",
        "lost_motion.after",
        "lost_motion.step",
        "lost_motion.start",
        "lost_motion.store",
    ),
    "probe": (
        "probe.size",
        "probe.verdict",
        "probe.closure",
        "probe.step",
        "probe.mode",
        "probe.start",
        "probe.drawing",
    ),
    "reports": ("reports.report", "reports.compare", "reports.make_history", "reports.status", "reports.campaigns"),
    "diagnosis": (
        "diagnosis.campaign",
        "diagnosis.start",
        "diagnosis.after",
        "diagnosis.found",
        "diagnosis.unexplained",
        "diagnosis.residual",
    ),
    "diagnosis.loop": ("loop.steps", "loop.verdict", "loop.step", "loop.progress", "loop.start", "loop.live"),
    "parameters": (
        "parameters.file",
        "parameters.backup",
        "parameters.download",
        "parameters.outcome",
        "parameters.progress",
        "parameters.bring",
        "parameters.restore",
        "parameters.tab.all",
        "parameters.tab.differences",
    ),
    "parameters.all": ("parameters.search", "parameters.read", "parameters.all"),
    "parameters.differences": ("parameters.differences",),
}
"""What a job needs: its start, its progress, its verdict, and the plot that matters. In the window without scrolling."""
TABS = {"diagnosis": ("campaign", "loop"), "parameters": ("all", "differences")}
WIDEST = "−888.888"


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ...]:
    directory = tmp_path_factory.mktemp("machine")
    paths = lay_out_axes(directory)
    verified = directory / "X-campaign" / "verify-001"
    verified.mkdir(parents=True)
    (verified / "campaign.json").write_text('{"kind": "verify", "axis": "X"}')
    rows = to_csv(campaign(lambda c: 2.0 * c["direction"], runs=2, targets=6))
    (verified / "verify.csv").write_text(f"# begun 2026-04-11T08:00:00+00:00\n{rows}")
    (verified / "finished").touch()
    for path in EXAMPLES.glob("probe_*.toml"):
        shutil.copy(path, directory)
    return (*paths, directory / "probe_machine.toml")


CHINESE = pytest.mark.skipif(bool(panel.NO_CHINESE), reason=panel.NO_CHINESE)
LOOKS = (
    *(pytest.param("Deutsch", size, id=f"de-{size[0]}") for size in SIZES),
    pytest.param("English", SMALLEST, id="en"),
    pytest.param("中文", SMALLEST, id="zh", marks=CHINESE),
)
"""German words are the longest."""


@pytest.fixture(scope="module")
def person(machine: tuple[Path, ...]) -> Iterator[Person]:
    """In control of X."""
    *axes, probe = machine
    with panel.served(*axes, "--probe", probe, "--pace", "0") as (address, _), panel.browser() as one:
        one.goes_to(f"{address}axis/X/overview")
        one.takes_control()
        yield one


def speaks(person: Person, language: str) -> None:
    """From now on, on every page."""
    goes_to(person, "overview")
    if language not in person.reads("language"):
        person.chooses("language", language)
        person.waits(lambda: language in person.reads("language"), "it speaks it")


def goes_to(person: Person, page: str) -> None:
    person.goes_to(f"{person.driver.current_url.rpartition('/')[0]}/{page}")
    person.waits(lambda: person.reads("header.state") != "", "the state is shown")


def sized(person: Person, size: tuple[int, int]) -> None:
    metrics: dict[str, Any] = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
    person.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)


@pytest.mark.parametrize(("language", "size"), LOOKS)
def test_nothing_overlaps_is_cut_or_leaves_its_card(person: Person, language: str, size: tuple[int, int]) -> None:
    sized(person, size)
    speaks(person, language)
    wrong = []
    for page in PAGES:
        goes_to(person, page)
        at_rest(person)
        person.driver.execute_script(
            "for (const one of document.querySelectorAll('.hil-value')) if (one.textContent === '–') one.textContent = arguments[0]",
            WIDEST,
        )
        for tab in TABS.get(page, ("",)):
            if tab:
                person.turns_to(f"{page}.tab.{tab}")
            wrong += [f"{page}: {one}" for one in settled(person, DEFECTS)]
            wanted = ESSENTIAL.get(f"{page}.{tab}", ESSENTIAL.get(page, ()))
            person.driver.execute_script("window.scrollTo(0, 0)")
            out = settled(person, OUT_OF_SIGHT, [*BAR, *wanted])
            wrong += [f"{page}: {name} is out of sight" for name in out]
    assert not wrong, "\n".join(wrong)


LEGENDS = """
    const found = {};
    for (const box of document.querySelectorAll('.hil-plot')) {
        const chart = getElement(Number(box.id.slice(1)))?.chart, option = chart?.getOption();
        if (!box.getBoundingClientRect().width || !option?.legend?.[0]?.show || !option.grid?.length) continue;
        const curves = ['as found', 'with the tables', 'verified', 'uncorrected'].flatMap((one) => [one + ' +', one + ' −']);
        chart.setOption({ series: curves.map((name) => ({ name, type: 'line', data: [[0, 0], [1, 1]] })) });
        const legend = chart.getViewOfComponentModel(chart.getModel().getComponent('legend')).group;
        const own = legend.getBoundingRect(), grid = chart.getModel().getComponent('grid').coordinateSystem.getRect();
        const ticks = option.yAxis[0].axisLabel.fontSize / 2;
        found[box.dataset.name] = [legend.y + own.y + own.height, grid.y - ticks];
    }
    return found;
"""
"""Script: of each chart with a legend, here of eight curves, where that ends and where the highest label of the axis begins, px."""


@pytest.mark.parametrize("size", [(800, 600), SIZES[1]], ids=lambda size: f"{size[0]}")
def test_no_legend_covers_a_chart(person: Person, size: tuple[int, int]) -> None:
    sized(person, size)
    found: dict[str, list[float]] = {}
    for page in ("calibrate", "backlash", "lost_motion"):
        goes_to(person, page)
        at_rest(person)
        if page == "calibrate":
            person.waits(lambda: person.drawn("calibrate.curves"), "what is on disk is drawn")
        found |= person.driver.execute_script(LEGENDS)
    assert len(found) >= 3, found
    assert not {name: ends for name, ends in found.items() if ends[0] > ends[1]}


def test_what_overlaps_is_cut_or_hidden_is_noticed(person: Person) -> None:
    """What the test above would say of a page whose style is spoiled."""
    sized(person, SIZES[0])
    goes_to(person, "backlash")
    assert not settled(person, DEFECTS)
    spoil = "document.querySelector(`[data-name='${arguments[0]}']`).style.cssText = arguments[1]"
    person.driver.execute_script(
        spoil, "backlash.mean", "position: relative; display: inline-block; top: -30px; left: 20px"
    )
    person.driver.execute_script(spoil, "backlash.step", "width: 4px; height: 4px; overflow: hidden")
    person.driver.execute_script("document.querySelector(`[data-name='backlash.step']`).textContent = 'a long step'")
    found = "\n".join(person.driver.execute_script(DEFECTS))
    assert "overlap" in found
    assert "backlash.step is cut" in found
    person.driver.execute_script(spoil, "backlash.start", "position: absolute; top: 5000px")
    assert person.driver.execute_script(OUT_OF_SIGHT, ["backlash.start"]) == ["backlash.start"]


@pytest.mark.parametrize("language", ["Deutsch", pytest.param("中文", marks=CHINESE)], ids=["de", "zh"])
def test_the_page_brings_its_fonts_so_that_it_looks_the_same_everywhere(person: Person, language: str) -> None:
    """All but Chinese, which is drawn in one font of the machine, with the shapes of that language."""
    sized(person, SIZES[0])
    speaks(person, language)
    chinese = language == "中文"
    for page in PAGES:
        goes_to(person, page)
        assert "no-font" not in person.names()
        person.clicks("events.open")
        person.waits(lambda: person.finds("events.close").is_displayed(), "what happened is shown, with its signs")
        person.waits(
            lambda: person.driver.execute_script("return document.fonts.status") == "loaded", "the fonts have come"
        )
        found = foreign_fonts(person)
        assert len(found) == chinese, f"{page}: {found}"
        assert all(not name.endswith((" JP", " KR", " TC", " HK")) for name in found), found


def test_a_sign_that_the_page_does_not_bring_is_noticed(person: Person) -> None:
    before = set(foreign_fonts(person))
    person.driver.execute_script(
        "document.querySelector(`[data-name='header.job']`).textContent = String.fromCodePoint(0x5d0)"
    )
    assert set(foreign_fonts(person)) > before


def test_chinese_without_a_font_is_said_in_english(machine: tuple[Path, ...], tmp_path: Path) -> None:
    """With the fonts of matplotlib alone, which have no Chinese."""
    fonts = tmp_path / "fonts.conf"
    latin = Path(mpl.get_data_path()) / "fonts" / "ttf"
    fonts.write_text(f"<fontconfig><dir>{latin}</dir><cachedir>{tmp_path}</cachedir></fontconfig>")
    environment = {**os.environ, "FONTCONFIG_FILE": str(fonts)}
    with panel.served(machine[0], "--lang", "zh") as (address, _), panel.browser(environment) as one:
        one.goes_to(f"{address}axis/X/overview")
        one.waits(lambda: "no font with Chinese" in one.reads("no-font"), "it is said")
        assert one.finds("control.take").text == load("en")["control.take"]
        one.clicks("language")
        offered = lambda: [each.text for each in one.driver.find_elements("css selector", ".q-menu .q-item")]  # noqa: E731
        one.waits(lambda: offered() == ["English", "Deutsch", "Chinese"], "Chinese is offered in letters")


@pytest.mark.parametrize("ground", ["dark", "light"])
def test_every_text_is_legible(person: Person, ground: str) -> None:
    """By the colours that the browser computes, also of what cannot be pressed."""
    sized(person, SIZES[0])
    dark = "return document.body.classList.contains('body--dark')"
    if person.driver.execute_script(dark) != (ground == "dark"):
        person.clicks("looks")
        person.waits(lambda: person.driver.execute_script(dark) == (ground == "dark"), f"it is {ground}")
    wrong = []
    for page in PAGES:
        goes_to(person, page)
        wrong += [f"{page}: {one}" for one in settled(person, PALE)]
    person.driver.execute_script("document.querySelector(`[data-name='header.state']`).style.opacity = 0.3")
    assert any(one.startswith("header.state") for one in person.driver.execute_script(PALE))  # it notices
    assert not wrong, "\n".join(wrong)
