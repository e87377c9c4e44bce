"""The page's own script: every way to press stop, and what is told of one without an answer. A real browser, a slow server."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files

import pytest
from selenium.webdriver.common.keys import Keys
from support import panel
from support.panel import Person

pytestmark = [
    pytest.mark.slow,
    pytest.mark.browser,
    pytest.mark.skipif(bool(panel.WHY_NOT), reason=panel.WHY_NOT),
]
PAGE = """<!doctype html><meta charset="utf-8"><title>stop</title><link rel="icon" href="data:,">
<link rel="stylesheet" href="/panel.css"><script src="/panel.js"></script>
<div data-name="stop-lost" class="hil-lost" hidden>lost</div><button data-name="stop"><div>STOP</div></button>
<input data-name="untyped"><input data-name="text" type="text"><input data-name="password" type="password">
<textarea data-name="lines"></textarea><input data-name="number" type="number"><input data-name="chosen" type="text" readonly>
<input data-name="ticked" type="checkbox">"""


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
        kinds = {"/": "text/html", "/panel.css": "text/css", "/panel.js": "text/javascript"}
        text = PAGE if self.path == "/" else files("hil.app.panel").joinpath("static", self.path[1:]).read_text("utf-8")
        self._answer(200, kinds[self.path], text.encode())

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


@pytest.fixture(scope="module")
def person() -> Iterator[Person]:
    with panel.browser() as one:
        yield one


@pytest.fixture
def machine(person: Person) -> Iterator[Machine]:
    with serving() as one:
        person.goes_to(one.address)
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


def test_space_stops_wherever_it_is_not_typed(person: Person, machine: Machine) -> None:
    for name in ("number", "chosen", "ticked"):
        person.finds(name).send_keys(Keys.SPACE)
        settled(person)
        assert machine.stopped(1), name
    for name in ("untyped", "text", "password", "lines"):
        person.finds(name).send_keys(Keys.SPACE)
        settled(person)
        assert machine.stopped(0), name
        assert person.finds(name).get_property("value") == " "
        person.finds(name).send_keys(Keys.ESCAPE)
        settled(person)
        assert machine.stopped(1), name


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
