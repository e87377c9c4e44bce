"""What an operator decides by, in a real browser: choices hold, figures without meaning are not shown, switches say what runs, a start
needs control, a page that is not there stops too. A line each of what was wrong once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium.webdriver.common.by import By
from support import panel
from support.bench_axis import PASSWORDS, lay_out
from support.campaigns import campaign, wavy
from support.panel import Person

from hil.parameters.job import LARGEST_BYTES
from hil.records.rows import to_csv

pytestmark = [
    pytest.mark.outside,
    pytest.mark.browser,
    pytest.mark.skipif(bool(panel.WHY_NOT), reason=panel.WHY_NOT),
]
PICKS = 15
SEVERAL_LOOKS = 8
"""Looks of the page into the folder, two a second, after which a choice has to stand still."""
COUNT_BEATS = """
    if (window.count === undefined) {
        window.count = 0;
        const was = hilBeat;
        hilBeat = (...all) => { window.count += 1; was(...all); };
    }
"""
"""Script that counts the messages of the server, ten a second, in `window.count`: time by the server's clock, not by the host's."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An axis with four campaigns; that of the second month has a diagnosis whose records could not be held out."""
    directory = tmp_path_factory.mktemp("axis")
    path = lay_out(directory, machine="typical", sections=12)
    for month in (1, 2, 3, 4):
        here = directory / "X-campaign" / f"verify-{month:03d}"
        here.mkdir(parents=True)
        (here / "campaign.json").write_text(json.dumps({"kind": "verify", "axis": "X"}))
        (here / "finished").touch()
        rows = campaign(lambda c, size=month: size * wavy(c), runs=2, targets=6, scatter=0.0, seed=month)
        (here / "verify.csv").write_text(f"# begun 2026-0{month}-11T08:00:00+00:00\n{to_csv(rows)}")
    figures = {"rms_um": 49.07, "peak_um": 304.0}
    form = {"findings": [], "drawn": {}, "unexplained": False, "before": figures, "after": figures}
    form["held_out"] = {"how": "leave-one-quarter-out", "rows": 24}
    (directory / "X-campaign" / "verify-002" / "verify.diagnosis.json").write_text(json.dumps(form))
    path.rename(directory / "X.toml")
    return directory


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    """A job takes minutes, so that it runs until it is stopped, however slow the host is."""
    with panel.served(folder / "X.toml", "--pace", "0.2") as (found, _):
        yield found


@pytest.fixture(scope="module")
def person() -> Iterator[Person]:
    with panel.browser() as one:
        yield one
        one.goes_to("about:blank")


def chooses(person: Person, begun: str) -> None:
    """A campaign, by the date of its begin."""
    person.chooses("diagnosis.campaign", begun)
    person.waits(lambda: not person.driver.find_elements(By.CSS_SELECTOR, ".q-menu"), "the choice is closed")


def hears(person: Person, beats: int) -> None:
    """Wait for so many messages of the server."""
    person.driver.execute_script(COUNT_BEATS)
    until = int(person.driver.execute_script("return window.count")) + beats
    person.waits(lambda: person.driver.execute_script("return window.count") >= until, f"{beats} messages")


def test_every_choice_of_a_campaign_holds(person: Person, address: str) -> None:
    """While the page reads the folder anew, before it and after it."""
    person.goes_to(f"{address}axis/X/diagnosis")
    person.waits(lambda: "2026-02-11" in person.reads("diagnosis.campaign"), "the diagnosed one is chosen")
    held = 0
    for number in range(PICKS):
        begun = f"2026-0{1 + (number * 3 + 1) % 4}-11"
        chooses(person, begun)
        hears(person, 1 + 5 * (number % SEVERAL_LOOKS))
        held += begun in person.reads("diagnosis.campaign")
    assert held == PICKS


def test_figures_that_mean_nothing_are_no_headline(person: Person, address: str) -> None:
    person.goes_to(f"{address}axis/X/diagnosis")
    person.waits(lambda: "2026-02-11" in person.reads("diagnosis.campaign"), "the diagnosed one is chosen")
    person.waits(lambda: person.finds("diagnosis.not_held_out").is_displayed(), "it says why there is no figure")
    page = person.driver.find_element(By.TAG_NAME, "body").text
    assert "49.07" not in page
    assert "304" not in page


def test_without_control_nothing_is_lit_that_needs_it(person: Person, address: str) -> None:
    for page, names in (
        ("overview", ("overview.power_off", "overview.reset_fault")),
        ("calibrate", ("calibrate.start", "calibrate.verify")),
        ("diagnosis", ("diagnosis.start",)),
        ("parameters", ("parameters.backup", "parameters.restore")),
    ):
        person.goes_to(f"{address}axis/X/{page}")
        person.waits(lambda: person.finds("control.take").is_displayed(), "nobody holds control")
        for name in names:
            person.waits(lambda name=name: "take control first" in person.reads(name), f"{name} says why not")  # type: ignore[misc]
            assert not person.finds(name).is_enabled()


def test_a_file_that_is_no_set_or_too_large_is_refused_before_it_is_sent(
    person: Person, address: str, tmp_path: Path
) -> None:
    person.goes_to(f"{address}axis/X/parameters")
    person.takes_control()
    field = "[data-name='parameters.bring'] input[type=file]"
    for name, size in (("notes.txt", 10), ("large.toml", LARGEST_BYTES + 1)):
        (tmp_path / name).write_bytes(b"#" * size)
        person.driver.find_element(By.CSS_SELECTOR, field).send_keys(str(tmp_path / name))
        person.is_refused("was not sent: expected one ending in .toml")
    sent = "return performance.getEntriesByType('resource').filter((one) => one.name.includes('/upload/')).length"
    assert person.driver.execute_script(sent) == 0
    person.clicks("control.release")
    person.waits(lambda: person.finds("control.take").is_displayed(), "control is free")


def is_running(person: Person) -> bool:
    return "running" in str(person.finds("chip.X").get_attribute("class"))


def test_an_uncorrected_run_keeps_its_switch_over_a_reload_and_is_stopped_from_a_page_that_is_not_there(
    person: Person, address: str
) -> None:
    person.goes_to(f"{address}axis/X/calibrate")
    person.takes_control()
    is_on = lambda: person.finds("calibrate.correction").get_attribute("aria-checked") == "true"  # noqa: E731
    person.becomes_builder(PASSWORDS["HIL_KEY_PASSWORD"])
    person.clicks("calibrate.correction")
    person.waits(lambda: not is_on(), "it is off")
    person.clicks("calibrate.verify")
    person.agrees()
    person.waits(lambda: is_running(person), "it runs")
    for _ in range(2):
        person.driver.refresh()
        person.opens("calibrate.correction")
        person.waits(lambda: is_running(person), "it is told as running")
        hears(person, SEVERAL_LOOKS)
        assert is_running(person)
        assert not is_on()

    person.goes_to(f"{address}axis/Q/overview")
    assert person.finds("no-page").is_displayed()
    person.finds("stop").click()
    person.waits(lambda: "pressed" not in str(person.finds("stop").get_attribute("class")), "it is answered")
    assert not person.finds("stop-lost").is_displayed()
    person.finds("home").click()
    person.waits(lambda: "stopped by the operator" in person.reads("header.step"), "it was stopped")
    assert person.reads("header.percent") != "100 %"
    person.clicks("events.open")
    person.waits(lambda: "STOP" in person.reads("events.rows"), "the stop is in the log")
    assert "Stopped: measurement without correction" in person.reads("events.rows")
