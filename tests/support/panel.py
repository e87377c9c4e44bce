"""`hil panel` as a process, and a headless Chromium that shows it."""

from __future__ import annotations

import atexit
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
WHY_NOT = "" if CHROMIUM and DRIVER else "needs Debian's chromium and chromium-driver"
MARKS = [pytest.mark.outside, pytest.mark.browser, pytest.mark.skipif(bool(WHY_NOT), reason=WHY_NOT)]
"""Of a file whose tests look at the screen in a browser."""
PATIENCE_S = 90.0
IN_FOLD = "ancestor::*[contains(concat(' ', @class, ' '), ' hil-fold ')]"
_OPTIONS = (
    *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu", "--window-size=1600,1400"),
    "--disable-features=PreloadTopChromeWebUI",  # pages of the browser's own that nobody opens
)
_STILL = """
    new MutationObserver((_, one) => {
        if (!document.head) return;
        document.head.append(Object.assign(document.createElement('style'), {textContent: '* { transition: none !important }'}));
        one.disconnect();
    }).observe(document, {childList: true, subtree: true});
"""
"""Script of every page: nothing fades or slides, each step of which is drawn by the processor."""


def _draws_chinese() -> bool:
    lists = shutil.which("fc-list")
    return lists is not None and bool(subprocess.run([lists, ":lang=zh-cn"], capture_output=True, check=False).stdout)


NO_CHINESE = "" if _draws_chinese() else "needs a font with Chinese characters (Debian's fonts-noto-cjk)"


@contextmanager
def served(*arguments: str | Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Its address, and the process; ended as by Ctrl-C."""
    command = [sys.executable, "-m", "hil.app", "panel", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            assert address, process.stderr.read() if process.stderr else ""
            yield address, process
        finally:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                process.wait(PATIENCE_S)
    if process.returncode != -signal.SIGKILL:
        assert process.returncode == 0


WATCH = """
    window.hilFirstGone = {};
    window.hilLateMs = 0;
    const late = (since, every) => { window.hilLateMs = Math.max(window.hilLateMs, performance.now() - since - every); };
    let ticked = performance.now(), heard = performance.now();
    setInterval(() => { late(ticked, 20); ticked = performance.now(); }, 20);
    const beat = hilBeat;
    hilBeat = (...all) => { late(heard, 100); heard = performance.now(); beat(...all); };
    new MutationObserver((changes) => {
        for (const {target: one} of changes)
            if (one.dataset.live && one.classList.contains('hil-stale')) window.hilFirstGone[one.dataset.name] ??= Date.now();
    }).observe(document.body, {subtree: true, attributeFilter: ['class']});
"""
"""Script that notes when each card was first marked as not live, by name, in `window.hilFirstGone`, ms; and in `window.hilLateMs` how
late the page's own timer, or a message of the server, came at worst: what a busy host adds, ms."""


class Person:
    """A user with a browser; elements are found by their names."""

    def __init__(self, driver: webdriver.Chrome) -> None:
        self.driver = driver

    def goes_to(self, address: str) -> None:
        """Load a page; one of the screen is heard by its server then."""
        self.driver.get(address)
        self.waits(lambda: self.driver.execute_script("return window.did_handshake !== false"), "the server hears it")

    def finds(self, name: str) -> WebElement:
        return self.driver.find_element(By.CSS_SELECTOR, f'[data-name="{name}"]')

    def reads(self, name: str) -> str:
        """The text of an element; "" for one that is hidden."""
        return self.finds(name).text

    def opens(self, name: str) -> None:
        """Unfold what an element is in, if it is folded away."""
        script = """
            const fold = arguments[0].closest('.hil-fold');
            if (fold && !fold.classList.contains('q-expansion-item--expanded')) fold.querySelector('.q-item').click();
        """
        self.driver.execute_script(script, self.finds(name))
        self.waits(lambda: self.finds(name).is_displayed(), f"{name} is unfolded")

    def clicks(self, name: str) -> None:
        """Click an element, once it is there and can be pressed, which is unfolded before. What was drawn anew meanwhile is looked for
        again."""

        def clicked() -> bool:
            one = self.finds(name)
            if not one.is_displayed() and one.find_elements(By.XPATH, IN_FOLD):
                self.opens(name)
            if not (one.is_displayed() and one.is_enabled()):
                return False
            self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", one)
            one.click()
            return True

        self.waits(clicked, f"{name} is clicked")

    def chooses(self, name: str, text: str) -> None:
        """An entry of a selection, by a part of its text. Returns once it is clicked."""

        def clicked() -> bool:
            entries = self.driver.find_elements(By.CSS_SELECTOR, ".q-menu .q-item")
            if not entries:
                self.clicks(name)
                self.waits(lambda: self.driver.find_elements(By.CSS_SELECTOR, ".q-menu .q-item"), f"{name} is open")
                return False
            found = next((one for one in entries if text in one.text), None)
            if found is not None:
                found.click()
            return found is not None

        self.waits(clicked, f"{text} of {name} is clicked")

    def turns_to(self, tab: str) -> None:
        """Show another job of a page."""
        shown = lambda: "here" in str(self.finds(tab).get_attribute("class")).split()  # noqa: E731
        if not shown():
            self.clicks(tab)
        self.waits(shown, f"{tab} is shown")

    def types(self, name: str, text: str) -> None:
        field = self.finds(name)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(text)

    def presses(self, key: str) -> None:
        self.driver.find_element(By.TAG_NAME, "body").send_keys(key)

    def waits(self, condition: Callable[[], Any], what: str, within_s: float = PATIENCE_S) -> None:
        """Until a condition holds; it may fail meanwhile. Raises TimeoutError from its last failure."""
        deadline = time.monotonic() + within_s
        while True:
            failed: Exception | None = None
            try:
                if condition():
                    return
            except Exception as error:  # noqa: BLE001  what is drawn anew is gone for a moment
                failed = error
            if time.monotonic() > deadline:
                raise TimeoutError(f"not within {within_s:g} s: {what}") from failed
            time.sleep(0.1)  # each question costs browser and driver 10 ms of the processor

    def waits_to_read(self, name: str, text: str) -> None:
        self.waits(lambda: self.reads(name) == text, f"{name} says {text!r}")

    def waits_for_a_figure(self, name: str) -> float:
        """The number that an element shows, once it shows one."""
        found: list[float] = []

        def reads() -> bool:
            read = figure(self.reads(name))
            found.extend(() if read is None else (read,))
            return bool(found)

        self.waits(reads, f"{name} shows a figure")
        return found[0]

    def takes_control(self) -> None:
        """Of the axis of this page. Returns once the page says so."""

        def held() -> bool:
            if self.finds("control.take").is_displayed():
                self.clicks("control.take")
                self.waits(lambda: self.finds("control.release").is_displayed(), "control is taken", PATIENCE_S / 3)
            return self.finds("control.release").is_displayed()

        self.waits(held, "this browser holds control")

    def becomes_builder(self, key: str, reading: str = "") -> None:
        self.clicks("role.become_builder")
        self.waits(lambda: self.finds("role.key_password").is_displayed(), "the passwords are asked for")
        self.finds("role.key_password").send_keys(key)
        self.finds("role.reading_password").send_keys(reading)
        self.clicks("role.yes")

    def is_refused(self, word: str) -> None:
        """Wait for a note with this word in it, and close it."""
        self.waits(lambda: word in self._note().text, "the refusal is shown")
        self._note().find_element(By.CSS_SELECTOR, "button").click()
        self.waits(lambda: not self.driver.find_elements(By.CSS_SELECTOR, ".q-notification"), "the note is closed")

    def _note(self) -> WebElement:
        return self.driver.find_element(By.CSS_SELECTOR, ".q-notification")

    def names(self) -> set[str]:
        """Names of every element on the page, hidden ones included."""
        script = "return [...document.querySelectorAll('[data-name]')].map((one) => one.dataset.name)"
        return set(self.driver.execute_script(script))

    def drawn(self, chart: str) -> dict[str, int]:
        """Number of points of each curve of a chart."""
        number = int(str(self.finds(chart).get_attribute("id")).removeprefix("c"))
        script = (
            "return Object.fromEntries(getElement(arguments[0]).chart.getOption().series"
            ".map((one) => [one.name, one.data.length]))"
        )
        return dict(self.driver.execute_script(script, number))

    def table(self, name: str) -> list[list[str]]:
        """The rows of a table, without its heading."""
        script = (
            "return [...arguments[0].querySelectorAll('tbody tr')]"
            ".map((row) => [...row.cells].map((cell) => cell.innerText))"
        )
        return [row for row in self.driver.execute_script(script, self.finds(name)) if any(row)]

    def agrees(self) -> list[str]:
        """Answer yes to the one question that is shown; its lines."""
        self.waits(lambda: self.finds("question.yes").is_displayed(), "a question is asked")
        lines = [one.text for one in self.driver.find_elements(By.CSS_SELECTOR, '[data-name="question.line"]')]
        self.clicks("question.yes")
        self.waits(
            lambda: not self.driver.find_elements(By.CSS_SELECTOR, '[data-name="question.yes"]'), "it is answered"
        )
        return lines


def figure(text: str) -> float | None:
    """The number that an element shows, in English; None for anything else."""
    try:
        return float(text.replace("−", "-"))
    except ValueError:
        return None


_idle: list[webdriver.Chrome] = []
"""Browsers that nobody uses: a start takes two seconds of the processor."""


@contextmanager
def browser(environment: Mapping[str, str] | None = None) -> Iterator[Person]:
    """A headless Chromium that knows nothing of an earlier one. environment: in place of this process's, for a process of its own."""
    driver = _idle.pop() if _idle and environment is None else _started(environment)
    try:
        yield Person(driver)
        if environment is None:
            _forget(driver)
            _idle.append(driver)
    finally:
        if driver not in _idle:
            driver.quit()


def _started(environment: Mapping[str, str] | None) -> webdriver.Chrome:
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM or ""
    for option in _OPTIONS:
        options.add_argument(option)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER, env=environment))
    driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _STILL})
    return driver


def _forget(driver: webdriver.Chrome) -> None:
    """An empty page in the size of the window, without cookies."""
    driver.get("about:blank")
    for command in ("Emulation.clearDeviceMetricsOverride", "Network.clearBrowserCookies", "Storage.clearCookies"):
        driver.execute_cdp_cmd(command, {})


@atexit.register
def _quit() -> None:
    while _idle:
        _idle.pop().quit()
