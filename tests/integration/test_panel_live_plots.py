"""The live plots in a real browser: one pointer through all, zoom, pause, choice of channels, limits, marks, the page's numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.remote.webelement import WebElement
from support import panel
from support.backlash_axis import QUICK, lay_out
from support.panel import Person

pytestmark = panel.MARKS
FAR = QUICK.replace("run_in_mm = 0.2", "run_in_mm = 100.0") + "home = false\n"
"""A reversal that is a long way off, so that the axis moves until it is stopped."""
CHART = "getElement(Number(document.querySelector(`[data-name='plot.overview']`).id.slice(1))).chart"
ROWS = "hilLives.get(Number(document.querySelector(`[data-name='plot.overview']`).id.slice(1))).rows.length"


@pytest.fixture(scope="module")
def person(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Person]:
    """On the page of an axis, in German, with a job that moves it."""
    path = lay_out(tmp_path_factory.mktemp("axis"), "canopen", FAR)
    text = path.read_text(encoding="utf-8").replace("us_mm = 5.0", "us_mm = 205.0")
    path.write_text(text.replace("travel_velocity_mm_s = 100.0", "travel_velocity_mm_s = 30.0"), encoding="utf-8")
    with panel.served(path, "--lang", "de", "--pace", "0.2") as (address, _), panel.browser() as one:
        one.goes_to(f"{address}axis/X/backlash")
        one.takes_control()
        one.clicks("backlash.start")
        one.agrees()
        one.waits(lambda: "running" in str(one.finds("chip.X").get_attribute("class")), "the job runs")
        one.goes_to(f"{address}axis/X/overview")
        one.waits(lambda: looks(one, ROWS) > 10, "the last minute is drawn")
        yield one
        one.goes_to("about:blank")


def looks(person: Person, what: str) -> Any:
    return person.driver.execute_script(f"return {what}")


def in_the_first(person: Person) -> tuple[WebElement, int, int]:
    """The charts, and a place in the first of them where there are readings of the last seconds: from the middle of all, pixels."""
    box = person.finds("plot.overview")
    return box, box.size["width"] // 2 - 40, -(box.size["height"] // 2) + 80


def points_to(person: Person) -> None:
    """Move the mouse there."""
    box, right, upper = in_the_first(person)
    ActionChains(person.driver).move_to_element_with_offset(box, right - 6, upper).perform()
    ActionChains(person.driver).move_to_element_with_offset(box, right, upper).perform()


def pointed_at(person: Person) -> str:
    """What the pointer reads."""
    script = "return [...document.querySelectorAll('.hil-pointed')].map((one) => one.innerText).join(' ')"
    return str(person.driver.execute_script(script))


def test_one_pointer_reads_all_channels_in_the_pages_numbers(person: Person) -> None:
    def reads() -> bool:
        points_to(person)
        return re.search(r"Position\n\D?\d+[.,]\d", pointed_at(person)) is not None

    person.waits(reads, "the pointer reads the curves of an axis that moves")
    text = pointed_at(person)
    for name in ("Position", "Geschwindigkeit", "Drehmoment", "Schleppfehler"):
        assert name in text
    figures = re.findall(r"[−-]?\d[\d.,]*", text)
    assert figures
    assert not [one for one in figures if "." in one or "-" in one], text  # German: a comma, and U+2212
    assert all(len(one.partition(",")[2]) <= 4 for one in figures), text


def test_the_wheel_zooms_all_charts_and_new_readings_leave_the_zoom(person: Person) -> None:
    before = looks(person, f"{CHART}.getOption().dataZoom[0]")
    assert (before["start"], before["end"]) == (0, 100)
    assert len(before["xAxisIndex"]) == 4
    origin = ScrollOrigin.from_element(*in_the_first(person))
    ActionChains(person.driver).scroll_from_origin(origin, 0, -300).perform()
    shown = "(({start, end}) => end - start)({0}.getOption().dataZoom[0])".replace("{0}", CHART)
    person.waits(lambda: looks(person, shown) < 99.0, "it is zoomed")
    width = looks(person, shown)
    newest = "hilLives.values().next().value.last"
    since = looks(person, newest)
    person.waits(lambda: looks(person, newest) > since + 1.0, "more was read")
    assert looks(person, shown) == width
    person.driver.execute_script(f"{CHART}.dispatchAction({{type: 'dataZoom', start: 0, end: 100}})")


def test_a_pause_holds_the_picture_and_keeps_what_comes(person: Person) -> None:
    newest = "hilLives.values().next().value.last"
    person.clicks("overview.pause")
    person.waits(lambda: looks(person, "hilLives.values().next().value.paused"), "it is held")
    held, since = looks(person, f"{CHART}.getOption().series[0].data"), looks(person, newest)
    person.waits(lambda: looks(person, newest) > since + 1.0, "more was read")
    assert looks(person, f"{CHART}.getOption().series[0].data") == held
    person.clicks("overview.pause")
    person.waits(lambda: looks(person, f"{CHART}.getOption().series[0].data") != held, "it goes on")


def test_limits_and_the_stop_are_marked(person: Person) -> None:
    limits = looks(
        person,
        f"{CHART}.getOption().series[0].markLine.data.filter((one) => one.yAxis !== undefined).map((one) => one.yAxis)",
    )
    assert len(limits) == 2  # the ends of the travel
    heading = looks(person, f"{CHART}.getOption().yAxis[0].name")
    assert "Grenzen" in heading
    assert re.search(r"−?\d", heading)
    marks = f"{CHART}.getOption().series[0].markLine.data.filter((one) => one.xAxis !== undefined).map((one) => one.label.formatter)"
    assert "■" not in looks(person, marks)
    person.clicks("stop")
    person.waits(lambda: "■" in looks(person, marks), "the stop is marked")


def test_the_channels_can_be_chosen(person: Person) -> None:
    """Last, as it leaves a channel out."""
    assert looks(person, f"{CHART}.getOption().series.length") == 4
    person.chooses("overview.channels", "Drehmoment")
    person.waits(lambda: looks(person, f"{CHART}.getOption().series.length") == 3, "one is left out")
    names = looks(person, f"{CHART}.getOption().yAxis.map((one) => one.name.split(',')[0])")
    assert names == ["Position", "Geschwindigkeit", "Schleppfehler"]
