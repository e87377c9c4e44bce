"""What an operator decides by, in a real browser: a file is refused before it is sent, a switch says what runs,
a page that is not there stops too."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium.webdriver.common.by import By
from support import panel
from support.bench_axis import PASSWORDS, lay_out
from support.panel import Person

from hil.parameters.job import LARGEST_BYTES

pytestmark = panel.MARKS
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
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A job takes minutes, so that it runs until it is stopped, however slow the host is."""
    path = lay_out(tmp_path_factory.mktemp("axis"), machine="typical", sections=12)
    with panel.served(path, "--pace", "0.2") as (found, _):
        yield found


def hears(person: Person, beats: int) -> None:
    """Wait for so many messages of the server."""
    person.driver.execute_script(COUNT_BEATS)
    until = int(person.driver.execute_script("return window.count")) + beats
    person.waits(lambda: person.driver.execute_script("return window.count") >= until, f"{beats} messages")


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
