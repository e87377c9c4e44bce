"""What is not live does not look live: server, drive and instrument killed or frozen while a real browser shows them."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support import panel
from support.machine import SimulatedMachine, machine
from support.panel import WATCH, Person

pytestmark = panel.MARKS
WITHIN_S = 1.2
TITLES = {"en": "NO LIVE DATA", "de": "KEINE LIVE-DATEN"}


@pytest.fixture(scope="module")
def axis(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatedMachine]:
    """Whose parts outlive every test."""
    with machine(tmp_path_factory.mktemp("machine")) as one:
        yield one


@pytest.fixture
def mortal(tmp_path: Path) -> Iterator[SimulatedMachine]:
    """Whose parts a test may kill."""
    with machine(tmp_path) as one:
        yield one


def is_stale(person: Person, card: str) -> bool:
    """Whether it is marked as not live, by itself or with what holds it."""
    return bool(person.driver.execute_script("return !!arguments[0].closest('.hil-stale')", person.finds(card)))


def goes_live(person: Person, address: str) -> None:
    """The page of the axis with everything live, watched from now on."""
    person.goes_to(f"{address}axis/X/overview")
    person.waits(lambda: any(map(str.isdigit, person.reads("overview.position"))), "the position is shown")
    cards = ("overview.drive", "overview.instrument")
    person.waits(lambda: not any(is_stale(person, card) for card in cards), "everything is live")
    assert not person.finds("no-data").is_displayed()
    person.driver.execute_script(WATCH)


def lost_after_s(person: Person, card: str, process: subprocess.Popen[str], how: signal.Signals) -> float:
    """Time from the signal until the card is marked, s, by one clock, without what the host came late meanwhile."""
    begun_s = time.time()
    process.send_signal(how)
    person.waits(lambda: is_stale(person, card), f"{card} is marked")
    gone_ms, late_ms = person.driver.execute_script(
        "return [window.hilFirstGone[arguments[0]], window.hilLateMs]", card
    )
    return float(gone_ms) / 1000.0 - begun_s - max(0.0, float(late_ms)) / 1000.0


def test_a_dead_server_is_told_in_the_pages_language(person: Person, axis: SimulatedMachine) -> None:
    with panel.served(axis.axis_file, "--lang", "de") as (address, process):
        goes_live(person, address)
        after_s = lost_after_s(person, "overview.drive", process, signal.SIGKILL)
        assert is_stale(person, "overview.instrument")
        assert is_stale(person, "header.state")
        assert TITLES["de"] in person.reads("no-data")
        process.wait(panel.PATIENCE_S)
    person.goes_to("about:blank")
    assert after_s <= WITHIN_S


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("part", ["drive", "laser"])
def test_the_source_that_is_lost_is_marked_in_time(
    person: Person, request: pytest.FixtureRequest, part: str, how: signal.Signals
) -> None:
    axis: SimulatedMachine = request.getfixturevalue("mortal" if how is signal.SIGKILL else "axis")
    lost, kept = "overview.drive", "overview.instrument"
    if part == "laser":
        lost, kept = kept, lost
    with panel.served(axis.axis_file) as (address, _):
        goes_live(person, address)
        after_s = lost_after_s(person, lost, getattr(axis, part), how)
        assert TITLES["en"] in person.reads("no-data")
        if part == "laser":
            assert not is_stale(person, kept)
        if how is signal.SIGSTOP:
            getattr(axis, part).send_signal(signal.SIGCONT)
            person.waits(lambda: not is_stale(person, lost), "it is live again without a reload")
            assert not person.finds("no-data").is_displayed()
        person.goes_to("about:blank")
    assert after_s <= WITHIN_S


def test_a_server_that_was_frozen_is_live_again(person: Person, axis: SimulatedMachine) -> None:
    with panel.served(axis.axis_file) as (address, process):
        goes_live(person, address)
        before = person.finds("overview.channels").rect
        try:
            assert lost_after_s(person, "overview.drive", process, signal.SIGSTOP) <= WITHIN_S
            person.waits(lambda: person.finds("no-data").is_displayed(), "it is told")
            assert person.finds("overview.channels").rect == before  # nothing moves under a finger
        finally:
            process.send_signal(signal.SIGCONT)
        person.waits(lambda: not is_stale(person, "overview.drive"), "it is live again")
        person.waits(lambda: not person.finds("no-data").is_displayed(), "and nothing is told")
        person.goes_to("about:blank")


def test_a_drive_lost_in_mid_job_is_an_alarm_with_cause_and_remedy(person: Person, mortal: SimulatedMachine) -> None:
    with panel.served(mortal.axis_file) as (address, _):
        person.goes_to(f"{address}axis/X/lost_motion")
        person.takes_control()
        person.clicks("lost_motion.start")
        person.agrees()
        person.waits(lambda: "running" in str(person.finds("chip.X").get_attribute("class")), "the job runs")
        mortal.drive.kill()
        person.waits(lambda: person.finds("alarm").is_displayed(), "an alarm is shown")
        assert "lost motion" in person.reads("alarm.what")
        assert len(person.reads("alarm.cause")) > len("2026-01-01 00:00:00 · ")
        assert "bus cable" in person.reads("alarm.remedy")
        person.waits(lambda: TITLES["en"] in person.reads("no-data"), "and that there is no live data")
        person.goes_to(f"{address}axis/X/reports")
        person.waits(lambda: person.finds("alarm").is_displayed(), "on every page")
        person.clicks("alarm.acknowledge")
        person.waits(lambda: not person.finds("alarm").is_displayed(), "until somebody has seen it")
        person.goes_to("about:blank")


def test_a_server_that_is_started_again_is_shown_without_a_reload_by_hand(
    person: Person, axis: SimulatedMachine
) -> None:
    with panel.served(axis.axis_file) as (address, process):
        goes_live(person, address)
        process.send_signal(signal.SIGKILL)
        process.wait(panel.PATIENCE_S)
        person.waits(lambda: is_stale(person, "overview.drive"), "it is lost")
    port = address.rstrip("/").rpartition(":")[2]
    with panel.served(axis.axis_file, "--port", port) as (again, _):
        assert again == address
        person.waits(lambda: not is_stale(person, "overview.drive"), "it is live again")
        person.waits(lambda: not person.finds("no-data").is_displayed(), "and nothing is told")
        person.goes_to("about:blank")
