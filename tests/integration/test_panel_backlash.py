"""The operator's screen in a real browser: a measurement from its start to what is written, with everything that may come between."""

import json
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from support import panel
from support.backlash_axis import QUICK, lay_out
from support.bench_axis import PASSWORDS
from support.panel import Person

from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key

pytestmark = panel.MARKS
KEY = PASSWORDS["HIL_KEY_PASSWORD"]
FAR = QUICK.replace("run_in_mm = 0.2", "run_in_mm = 100.0") + "home = false\n"
"""A reversal that is a long way off: time to do something meanwhile."""
SPEED_MM_S = 30.0


def axis_file(directory: Path, face: str = "canopen", backlash: str = QUICK) -> Path:
    """With a builder's pair beside it, travelling at SPEED_MM_S."""
    path = lay_out(directory, face, backlash)
    text = path.read_text(encoding="utf-8").replace("us_mm = 5.0", "us_mm = 205.0")
    text = text.replace("travel_velocity_mm_s = 100.0", f"travel_velocity_mm_s = {SPEED_MM_S}")
    path.write_text(text, encoding="utf-8")
    key = new_key()
    save_private_key(directory / "builder.key", key, KEY, cost=Cost(n=1 << 10, r=8, p=1))
    save_public_key(directory / "builder.pub", key.public_key())
    return path


def starts(person: Person) -> list[str]:
    """A measurement; what was asked."""
    person.clicks("backlash.start")
    return person.agrees()


@pytest.fixture(scope="module")
def slowly(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A machine in slow motion, a fifth of its speed."""
    path = axis_file(tmp_path_factory.mktemp("slowly"), backlash=FAR)
    with panel.served(path, "--pace", "0.2") as (address, _):
        yield address


def test_from_start_to_written_and_back(person: Person, tmp_path: Path) -> None:
    with panel.served(axis_file(tmp_path), "--pace", "0", "--lang", "de") as (address, _):
        speaks_german_in_two_looks(person, address)
        person.goes_to(f"{address}axis/X/backlash")
        person.takes_control()
        asked = starts(person)
        assert any("2201h" in line and "0" in line for line in asked)
        assert any("203.800" in line and "205.000" in line for line in asked)
        both = [person.waits_for_a_figure(f"backlash.{way}") for way in ("plus_minus", "minus_plus")]
        mean = person.waits_for_a_figure("backlash.mean")
        assert mean == pytest.approx(sum(both) / 2.0, abs=0.011)
        assert mean == pytest.approx(53.0, abs=2.0)
        person.waits(lambda: sum(person.drawn("backlash.plot").values()) > 40, "the graph is drawn")

        # locked without the password: the button is not to be pressed, and a wrong password opens nothing
        person.waits(lambda: person.finds("backlash.start").is_enabled(), "the job is over")
        assert not person.finds("backlash.write").is_enabled()
        person.becomes_builder("not it")
        person.is_refused("password")
        assert not person.finds("backlash.write").is_enabled()
        person.becomes_builder(KEY)
        person.clicks("backlash.write")
        assert any("2201h" in line for line in person.agrees())
        person.waits(lambda: person.reads("backlash.present").endswith(f"({mean:.2f} µm)"), "the mean is in the drive")
        person.waits_to_read("backlash.original", "0.00")
        person.waits_to_read("backlash.function", "on")
        for expected in ("off", "on"):
            person.clicks("backlash.switch")
            person.agrees()
            person.waits_to_read("backlash.function", expected)
        person.clicks("backlash.restore")
        person.agrees()
        person.waits_to_read("backlash.present", "0.00 (0.00 µm)")
        person.clicks("control.release")
        person.waits(lambda: not person.finds("backlash.write").is_enabled(), "the role ends with control")


def speaks_german_in_two_looks(person: Person, address: str) -> None:
    """And loads nothing from elsewhere; afterwards it speaks English."""
    person.goes_to(f"{address}axis/X/overview")
    person.waits_to_read("overview.state", "Einschaltsperre")
    dark = ground(person)
    person.clicks("looks")
    person.waits(lambda: ground(person) != dark, "light")
    assert loaded_from(person) == {address.rstrip("/")}
    person.chooses("language", "English")
    person.waits_to_read("overview.state", "switch on disabled")


def test_stop_in_motion(person: Person, slowly: str) -> None:
    """By click and by both keys: what the screen tells in the machine's own time, which no slow host can stretch."""
    person.goes_to(f"{slowly}axis/X/backlash")
    person.takes_control()
    for stop in (
        lambda: person.clicks("stop"),
        lambda: person.presses(Keys.ESCAPE),
        lambda: person.presses(Keys.SPACE),
    ):
        start_mm = person.waits_for_a_figure("backlash.position")
        starts(person)
        person.waits(
            lambda start=start_mm: abs(person.waits_for_a_figure("backlash.position") - start) > 4.0, "it moves"
        )  # type: ignore[misc]
        stop()
        person.waits_to_read("backlash.step", "stopped by the operator")
        person.waits(lambda: person.reads("header.state") == "switch on disabled", "as it was found")
        told = re.fullmatch(r"at rest (\d+) ms after the stop, ([\d.]+) mm further", person.reads("header.job"))
        assert told is not None
        assert int(told[1]) <= 50 + 10  # looked at every 10 ms
        assert float(told[2]) <= SPEED_MM_S * 0.06
    person.clicks("control.release")


def test_two_browsers_reload_and_leaving(person: Person, slowly: str) -> None:
    with panel.browser() as other:
        person.goes_to(f"{slowly}axis/X/backlash")
        person.takes_control()
        starts(person)
        other.goes_to(f"{slowly}axis/X/backlash")
        other.waits(lambda: "run 1 of 1" in other.reads("backlash.step"), "the other sees the same step")
        other.waits_to_read("control.who", "Browser 1 holds control")
        assert not other.finds("backlash.start").is_enabled()
        assert not other.finds("control.take").is_displayed()
        assert not other.finds("control.take_over").is_displayed()

        person.driver.refresh()
        person.waits_to_read("control.who", "You · operator")
        person.waits(lambda: "run 1 of 1" in person.reads("backlash.step"), "the measurement goes on")
        person.goes_to("about:blank")
        before_mm = other.waits_for_a_figure("backlash.position")
        other.waits(lambda: other.waits_for_a_figure("backlash.position") != before_mm, "it goes on with nobody there")
        other.clicks("stop")
        other.waits_to_read("backlash.step", "stopped by the operator")


def test_a_restarted_server_finds_what_was_left(person: Person, tmp_path: Path) -> None:
    """Killed in the middle: the note of the settings stands, the screen says so, and puts them back."""
    path = axis_file(tmp_path, backlash=FAR)
    note = tmp_path / "X-campaign" / "backlash-before.json"
    with panel.served(path, "--pace", "1") as (address, process):
        person.goes_to(f"{address}axis/X/backlash")
        person.takes_control()
        starts(person)
        person.waits(note.exists, "the settings are noted")
        process.send_signal(signal.SIGKILL)
        process.wait(panel.PATIENCE_S)
    assert json.loads(note.read_text())["2201h"] == 0
    with panel.served(path, "--pace", "0") as (address, _):
        person.goes_to(f"{address}axis/X/overview")
        person.waits(lambda: "backlash settings changed" in person.reads("overview.left_over"), "it is told")
        person.goes_to(f"{address}axis/X/backlash")
        person.waits(lambda: "restore them" in person.reads("backlash.messages"), "here too")
        person.takes_control()
        person.clicks("backlash.restore")
        person.agrees()
        person.waits(lambda: not note.exists(), "put back")


def ground(person: Person) -> str:
    """The colour of the page."""
    return person.driver.find_element(By.TAG_NAME, "body").value_of_css_property("background-color")


def loaded_from(person: Person) -> set[str]:
    """Where everything came from that the page has loaded."""
    script = "return performance.getEntriesByType('resource').map((one) => new URL(one.name).origin)"
    return {origin for origin in person.driver.execute_script(script) if origin != "null"}
