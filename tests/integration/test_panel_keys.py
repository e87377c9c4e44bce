"""Enter confirms, a start leaves the focus on STOP, and Esc does one thing at a time: a real browser and an axis in motion."""

from __future__ import annotations

from pathlib import Path

from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.keys import Keys
from support import panel
from support.backlash_axis import QUICK, lay_out
from support.panel import Person

pytestmark = panel.MARKS
FAR = QUICK.replace("run_in_mm = 0.2", "run_in_mm = 100.0") + "home = false\n"
"""A reversal that is a long way off: time to do something meanwhile."""


def focused(person: Person) -> str:
    return str(
        person.driver.execute_script("return document.activeElement?.closest('[data-name]')?.dataset.name ?? ''")
    )


def types(person: Person, key: str) -> None:
    """Into whatever has the focus."""
    ActionChains(person.driver).send_keys(key).perform()


def is_running(person: Person) -> bool:
    return "running" in str(person.finds("chip.X").get_attribute("class"))


def test_enter_confirms_and_esc_does_one_thing_at_a_time(tmp_path: Path) -> None:
    path = lay_out(tmp_path, "canopen", FAR)
    text = path.read_text(encoding="utf-8").replace("us_mm = 5.0", "us_mm = 205.0")
    path.write_text(text.replace("travel_velocity_mm_s = 100.0", "travel_velocity_mm_s = 30.0"), encoding="utf-8")
    with panel.served(path, "--pace", "0.2") as (address, _), panel.browser() as person:
        person.goes_to(f"{address}axis/X/backlash")
        person.takes_control()
        person.clicks("backlash.start")
        person.waits(lambda: focused(person) == "question.yes", "it is asked")
        person.waits_to_read(
            "question.yes", "Measure backlash of X"
        )  # it fades in: no text to a reader until it is visible
        person.waits_to_read("question.no", "Cancel")
        types(person, Keys.ESCAPE)
        person.waits(
            lambda: not person.driver.find_elements("css selector", "[data-name='question.yes']"),
            "Esc is the harmless one",
        )
        assert not is_running(person)
        for _ in range(2):
            person.clicks("backlash.start")
            person.waits(lambda: focused(person) == "question.yes", "the question has the focus")
            types(person, Keys.ENTER)
            person.waits(lambda: is_running(person), "Enter confirms")
            person.waits(lambda: focused(person) == "stop", "the focus is on STOP")
            person.clicks("role.become_builder")
            person.waits(lambda: focused(person) == "role.key_password", "a password is asked for")
            types(person, "a b")  # Space types
            assert is_running(person)
            types(person, Keys.ESCAPE)
            person.waits_to_read("backlash.step", "stopped by the operator")
            assert person.finds("role.key_password").is_displayed()  # Esc has stopped and closed nothing
            assert person.finds("role.key_password").get_property("value") == "a b"
            person.waits(lambda: not is_running(person), "it is at rest")
            person.finds("role.key_password").click()
            types(person, Keys.ESCAPE)
            person.waits(
                lambda: not person.driver.find_elements("css selector", "[data-name='role.key_password']"),
                "Esc closes it",
            )
