"""The page's own script: every way to press stop, and what is told of one without an answer. A real browser, a slow server."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import PurePosixPath

import pytest
from selenium.webdriver.common.keys import Keys
from support import panel
from support.panel import Person

pytestmark = panel.MARKS
PAGE = """<!doctype html><meta charset="utf-8"><title>stop</title><link rel="icon" href="data:,">
<link rel="stylesheet" href="/panel.css"><script src="/panel.js"></script>
<div data-name="stop-lost" class="hil-lost" hidden>lost</div><button data-name="stop"><div>STOP</div></button>
<input data-name="untyped"><input data-name="text" type="text"><input data-name="password" type="password">
<textarea data-name="lines"></textarea><input data-name="number" type="number"><input data-name="chosen" type="text" readonly>
<input data-name="ticked" type="checkbox"><button data-name="button">button </button>"""


BEATS = """
    clearInterval(window.beating);
    window.beating = setInterval(() => hilBeat({%s}, performance.now()), 20);
"""
"""Script: a server that sends this of its axes until another is sent."""


class Machine(ThreadingHTTPServer):
    """Serves the page; each stop is noted, and answered as soon as `answers` says with which status."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.stops: queue.Queue[None] = queue.Queue()
        self.answers: queue.Queue[int] = queue.Queue()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/"

    def stopped(self, times: int) -> bool:
        """Whether so many stops came and no more; they are answered."""
        for _ in range(times):
            self.stops.get(timeout=panel.PATIENCE_S)
            self.answers.put(200)
        return self.stops.empty()


class _Handler(BaseHTTPRequestHandler):
    server: Machine

    def do_GET(self) -> None:
        kinds = {".css": "text/css", ".js": "text/javascript", ".woff2": "font/woff2"}
        if self.path == "/":
            self._answer(200, "text/html", PAGE.encode())
        else:
            file = files("hil.app.panel").joinpath("static", self.path[1:])
            self._answer(200, kinds[PurePosixPath(self.path).suffix], file.read_bytes())

    def do_POST(self) -> None:
        self.server.stops.put(None)
        self._answer(self.server.answers.get(timeout=panel.PATIENCE_S), "text/plain", b"")

    def _answer(self, status: int, kind: str, body: bytes) -> None:
        self.send_response(status)
        self.send_header("content-type", kind)
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Nothing."""


@contextmanager
def serving() -> Iterator[Machine]:
    with Machine() as machine:
        thread = threading.Thread(target=machine.serve_forever)
        thread.start()
        try:
            yield machine
        finally:
            machine.shutdown()
            thread.join()


@pytest.fixture
def machine(person: Person) -> Iterator[Machine]:
    with serving() as one:

        def comes() -> bool:
            person.goes_to(one.address)
            return bool(person.driver.execute_script("return typeof hilBeat === 'function'"))

        person.waits(comes, "the page and its script are there")  # a busy host may drop the request for the script
        yield one
        person.goes_to("about:blank")


def settled(person: Person) -> None:
    """Whatever the page was to send because of what was done to it is sent: its own request after them is answered."""
    person.driver.execute_async_script("setTimeout(() => fetch('/').then(arguments[0]), 0)")


def test_each_way_to_press_it_stops_once(person: Person, machine: Machine) -> None:
    person.finds("stop").click()
    settled(person)
    assert machine.stopped(1)
    person.finds("stop").send_keys(Keys.ENTER)
    settled(person)
    assert machine.stopped(1)
    person.driver.execute_script("arguments[0].click()", person.finds("stop"))  # as an aid to seeing does
    settled(person)
    assert machine.stopped(1)
    person.presses(Keys.ESCAPE)
    person.presses(Keys.SPACE)
    settled(person)
    assert machine.stopped(2)


def test_space_presses_a_button_and_types_in_a_field(person: Person, machine: Machine) -> None:
    """With the focus on STOP or on nothing it stops; Esc stops wherever the focus is, as long as anything may move."""
    person.driver.execute_script(
        "document.querySelector('[data-name=button]').onclick = (one) => { one.target.textContent += 'pressed ' }"
    )
    person.finds("button").send_keys(Keys.SPACE)
    settled(person)
    assert machine.stopped(0)
    assert person.reads("button").count("pressed") == 1
    for name in ("untyped", "text", "password", "lines", "ticked"):
        person.finds(name).send_keys(Keys.SPACE)
        settled(person)
        assert machine.stopped(0), name
        if name != "ticked":
            assert person.finds(name).get_property("value") == " "
        person.finds(name).send_keys(Keys.ESCAPE)
        settled(person)
        assert machine.stopped(1), name
    assert person.finds("ticked").is_selected()
    person.finds("stop").send_keys(Keys.SPACE)
    settled(person)
    assert machine.stopped(1)


def test_the_keys_stop_nothing_where_all_axes_are_known_to_stand(person: Person, machine: Machine) -> None:
    """Esc is then for what is on top; Space on STOP still presses it."""
    at_rest = BEATS % "X: {drive: 0, busy: false, why: {}}"
    person.driver.execute_script(
        "window.timesClosed = 0; window.addEventListener('keydown', (one) => { if (one.key === 'Escape') window.timesClosed += 1 })"
    )
    for key, stops in ((Keys.ESCAPE, 0), (Keys.SPACE, 0)):
        person.driver.execute_script(at_rest)
        person.waits(lambda: not person.driver.execute_script("return hilBusy()"), "it is known to stand")
        person.presses(key)
        settled(person)
        assert machine.stopped(stops)
    assert person.driver.execute_script("return window.timesClosed") == 1
    person.driver.execute_script(at_rest)
    person.finds("stop").send_keys(Keys.SPACE)
    settled(person)
    assert machine.stopped(1)
    person.driver.execute_script(BEATS % "X: {drive: 0, busy: false, why: {}}, Y: {drive: 0, busy: true, why: {}}")
    person.waits(lambda: person.driver.execute_script("return hilBusy()"), "another axis is busy")
    person.presses(Keys.ESCAPE)
    settled(person)
    assert machine.stopped(1)
    assert person.driver.execute_script("return window.timesClosed") == 1  # it does one thing only


def test_a_stop_without_an_answer_is_told_until_its_answer_comes(person: Person, machine: Machine) -> None:
    lost = person.finds("stop-lost")
    person.finds("stop").click()
    machine.stops.get(timeout=panel.PATIENCE_S)
    person.waits(lost.is_displayed, "told")
    person.finds("stop").click()  # not covered
    machine.stops.get(timeout=panel.PATIENCE_S)
    machine.answers.put(200)
    machine.answers.put(200)  # the first was not taken back: both are answered
    person.waits(lambda: not lost.is_displayed(), "no longer told")


def test_a_stop_that_is_refused_is_told_until_one_arrives(person: Person, machine: Machine) -> None:
    lost = person.finds("stop-lost")
    machine.answers.put(503)
    person.presses(Keys.ESCAPE)
    person.waits(lost.is_displayed, "told")
    machine.answers.put(200)
    person.presses(Keys.ESCAPE)
    person.waits(lambda: not lost.is_displayed(), "no longer told")


@pytest.mark.usefixtures("machine")
def test_a_message_is_as_old_as_it_was_sent_not_as_it_was_read(person: Person) -> None:
    """A page that was busy for a second reads what waited meanwhile: the server may be gone by then."""
    script = """
        const sentMs = () => performance.now() + 5000;  // by a clock of its own
        for (let count = 0; count < 5; count += 1) hilBeat({}, sentMs());
        const fresh = hilServerLost(), last = sentMs();
        const until = performance.now() + HIL_BEAT_LOST_MS + 100;
        while (performance.now() < until);
        hilBeat({}, last);
        const old = hilServerLost();
        hilBeat({}, sentMs());
        return [fresh, old, hilServerLost()];
    """
    assert person.driver.execute_script(script) == [False, True, False]


@pytest.mark.usefixtures("machine")
def test_a_connection_that_is_closed_is_a_server_that_is_gone_at_once(person: Person) -> None:
    person.driver.execute_script(
        "window.socket = {on: (name, call) => { window.said = [name, call] }}; hilBeat({}, performance.now());"
    )
    person.waits(lambda: person.driver.execute_script("return window.said?.[0]") == "disconnect", "it listens")
    script = "hilBeat({}, performance.now()); const before = hilServerLost(); window.said[1](); return [before, hilServerLost()]"
    assert person.driver.execute_script(script) == [False, True]
    again = "hilBeat({}, performance.now() - 1e6); return hilServerLost()"  # another server, whose clock is another
    assert person.driver.execute_script(again) is False
    left = "dispatchEvent(new Event('pagehide')); window.said[1](); return hilServerLost()"
    assert person.driver.execute_script(left) is False  # whoever leaves the page closes it too


@pytest.mark.usefixtures("machine")
@pytest.mark.parametrize("source", ["drive", "instrument"])
def test_a_page_that_has_just_come_tells_since_when_the_server_knows(person: Person, source: str) -> None:
    """A change of page loads the script anew; the loss is 34 s old by then."""
    script = """
        document.body.insertAdjacentHTML('beforeend', `<section data-name="no-data" data-axis="X" hidden><p data-name="no-data.since"
            data-text="{seconds}"></p></section>`);
        const X = {drive: 0, instrument: 0, busy: false, why: {}, lost: {drive: 0, instrument: 0}};
        X[arguments[0]] = null;
        X.lost[arguments[0]] = 34.2;
        hilLostSince.clear();
        hilBeat({X}, performance.now());
        return Number(document.querySelector("[data-name='no-data.since']").textContent);
    """
    assert person.driver.execute_script(script, source) == 34


@pytest.mark.usefixtures("machine")
def test_an_instrument_that_the_job_does_not_read_is_marked_and_is_no_alarm(person: Person) -> None:
    script = """
        document.body.insertAdjacentHTML('beforeend', `<section data-name="no-data" data-axis="X" hidden><p data-name="no-data.since"
            data-text="{time}"></p></section><p data-name="figure" data-live="X.instrument">1.0</p>`);
        const seen = (why) => {
            hilBeat({X: {drive: 0, instrument: 9.0, busy: true, why: {instrument: why}}}, performance.now());
            const marked = document.querySelector("[data-name='figure']").classList.contains('hil-stale');
            return [marked, !document.querySelector("[data-name='no-data']").hidden];
        };
        return [seen('unused'), seen('')];
    """
    assert person.driver.execute_script(script) == [[True, False], [True, True]]
