"""Screenshots of every page in a real browser: each element that has to be there is looked for in the picture itself."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium.webdriver.common.by import By
from support import panel
from support.panel import Person
from support.screenshots import complaints
from support.two_axes import lay_out_axes

pytestmark = panel.MARKS
EXAMPLES = Path(__file__).parents[2] / "hil" / "examples"
FRAME = (
    "stop",
    "header.state",
    "control.who",
    "control.release",
    "role.become_builder",
    "navigation",
    "language",
    "looks",
)
LISTED = {
    "overview": (
        *(f"overview.{name}" for name in ("state", "position", "remaining", "following_error", "torque", "velocity")),
        *(
            f"overview.{name}"
            for name in ("measured_raw", "signal", "age", "correction_now", "in_force", "environment")
        ),
        *(f"overview.{name}" for name in ("power_off", "reset_fault", "not_safety")),
        *("plot.overview", "overview.channels", "overview.pause"),
    ),
    "backlash": (
        *(f"backlash.{name}" for name in ("instructions", "where", "position", "remaining", "speed", "runs", "step")),
        *(f"backlash.{name}" for name in ("present", "original", "plus_minus", "minus_plus", "mean", "plot")),
        *(f"backlash.{name}" for name in ("start", "write", "restore", "switch", "function", "look")),
    ),
}
"""Of the other pages every element that is shown is looked for."""
NO_CHINESE = pytest.mark.skipif(bool(panel.NO_CHINESE), reason=panel.NO_CHINESE)
LOOKS = (("English", "dark"), ("Deutsch", "light"), pytest.param("中文", "dark", marks=NO_CHINESE))
WIDEST = "−888.888"


@pytest.fixture(scope="module")
def person(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Person]:
    """In control of the first of two axes of a machine with a probe."""
    directory = tmp_path_factory.mktemp("machine")
    paths = lay_out_axes(directory)
    for path in EXAMPLES.glob("probe_*.toml"):
        shutil.copy(path, directory)
    probe = directory / "probe_machine.toml"
    with panel.served(*paths, "--probe", probe, "--pace", "0") as (address, _), panel.browser() as one:
        one.goes_to(f"{address}axis/X/overview")
        one.takes_control()
        yield one


def pages(person: Person) -> list[str]:
    """By the navigation."""
    links = person.driver.find_elements(By.CSS_SELECTOR, "[data-name='navigation'] a")
    return [str(link.get_attribute("href")).rpartition("/")[2] for link in links]


def goes_to(person: Person, page: str) -> None:
    """And waits until its plots are there."""
    person.goes_to(f"{person.driver.current_url.rpartition('/')[0]}/{page}")
    person.waits(lambda: person.finds("header.state").text == person.reads("header.state") != "", "the state is shown")
    charts = (
        "return [...document.querySelectorAll('.hil-plot')].every((one) => getElement(Number(one.id.slice(1)))?.chart)"
    )
    person.waits(lambda: person.driver.execute_script(charts), "the plots are drawn")


def shown(person: Person) -> list[str]:
    """The names of all elements that are displayed and hold anything; a note is empty as long as there is nothing to say."""
    script = """
        const parts = 'canvas, svg, input, button';
        const holds = (one) => one.innerText?.trim() || one.matches(parts) || one.querySelector(parts);
        const found = [...document.querySelectorAll('[data-name]:not([data-name^="no-data"])')]
            .filter((one) => one.checkVisibility() && holds(one));
        return found.map((one) => one.dataset.name);
    """
    return [str(name) for name in person.driver.execute_script(script)]


def speaks(person: Person, language: str) -> None:
    person.driver.execute_script("window.before = true")
    person.chooses("language", language)
    comes_anew(person)
    person.waits(lambda: language in person.reads("language"), "it speaks it")


def comes_anew(person: Person) -> None:
    """Wait until the page was loaded again."""
    person.waits(lambda: person.driver.execute_script("return !window.before"), "the page is loaded again")


@pytest.mark.parametrize(("language", "ground"), LOOKS, ids=["en", "de", "zh"])
def test_every_element_is_in_the_picture(person: Person, language: str, ground: str) -> None:
    """Not only in the page: drawn in its place, uncovered, within its card, and large enough for a finger."""
    if language not in person.reads("language"):
        speaks(person, language)
    if ("body--dark" in str(person.driver.find_element(By.TAG_NAME, "body").get_attribute("class"))) != (
        ground == "dark"
    ):
        person.driver.execute_script("window.before = true")
        person.clicks("looks")
        comes_anew(person)
    wrong = []
    for page in LISTED if language == "中文" else pages(person):  # its words are the shortest
        goes_to(person, page)
        person.driver.execute_script(
            "for (const one of document.querySelectorAll('.hil-value:not(.small)')) one.textContent = arguments[0]",
            WIDEST,
        )
        wrong += [f"{page}: {one}" for one in complaints(person, (*FRAME, *(LISTED.get(page) or shown(person))))]
    assert not wrong, "; ".join(wrong)


def test_a_picture_without_an_element_is_noticed(person: Person) -> None:
    """What the test above would say of a page that hides, covers, shrinks or forgets something."""
    goes_to(person, "backlash")
    hide = "document.querySelector(`[data-name='${arguments[0]}']`).style[arguments[1]] = arguments[2]"
    spoiled = {
        "backlash.instructions": ("opacity", "0"),
        "backlash.mean": ("visibility", "hidden"),
        "backlash.step": ("display", "none"),
        "backlash.start": ("zoom", "0.3"),
    }
    for name, (style, value) in spoiled.items():
        person.driver.execute_script(hide, name, style, value)
    found = complaints(person, LISTED["backlash"])
    assert {one.split()[0] for one in found} >= spoiled.keys()
