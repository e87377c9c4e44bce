"""What a running job asks, as it is drawn: in the page's language, with buttons in the browser that holds control alone."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest
from nicegui import Client
from nicegui.page import page
from support.screen import begun_by, inside

from hil.app.panel.frame import draw_question
from hil.desk.asking import Pending
from hil.desk.desk import Desk
from hil.desk.job import Question
from hil.ui.screen.browsers import Browser
from hil.ui.screen.texts import Texts
from hil.ui.screen.view import View

MINE = "a token"


class Desks:
    """As far as a question needs one."""

    name = "X"
    control = SimpleNamespace(holds=lambda token: token == MINE)

    def __init__(self, kind: str, figures: dict[str, str]) -> None:
        self.question = Pending(7, Question(kind, figures, 600.0))
        self.answers: list[tuple[str | None, int, bool]] = []

    def answer(self, token: str | None, number: int, *, yes: bool) -> None:
        self.answers.append((token, number, yes))


def drawn(desk: Desks, language: str, token: str = MINE) -> dict[str, Any]:
    """The elements by their names, and whatever is around the buttons as "buttons"."""
    client = Client(page("/"), request=None)
    browser = Browser(1, language, tokens={"X": token})
    with client:
        draw_question(View(cast(Desk, desk), (), Texts(language), browser, client, lambda _axis: ()))
    named = {str(one.props.get("data-name")): one for one in client.elements.values()}
    around = named["ask.yes"].parent_slot
    return named | {"buttons": None if around is None else around.parent}


@pytest.mark.parametrize(
    ("language", "words"),
    [
        ("de", "Bitte einstellen: Last = 60 kg."),
        ("zh", "请设置：载荷 = 60 kg。"),
        ("en", "Please bring it about: load ="),
    ],
)
def test_it_is_asked_in_the_language_of_the_page(language: str, words: str) -> None:
    shown = drawn(Desks("condition", {"condition": "load_kg", "value": "60 kg"}), language)
    assert shown["ask.words"].text.startswith(words)
    assert "10 min" in shown["ask.wait"].text
    assert (shown["buttons"].visible, shown["ask.elsewhere"].visible) == (True, False)


def test_only_whoever_holds_control_can_answer() -> None:
    run = "measure the same once more, there and back twice (4 rows, about 9 min; the axis can do it alone)"
    desk = Desks("run", {"run": run})
    elsewhere = drawn(desk, "de", token="of another browser")
    assert "dasselbe noch einmal messen" in elsewhere["ask.words"].text
    assert (elsewhere["buttons"].visible, elsewhere["ask.elsewhere"].visible) == (False, True)
    mine = drawn(desk, "de")

    async def answers() -> None:
        for button in (mine["ask.no"], mine["ask.yes"]):
            await asyncio.gather(*begun_by(button))

    inside(answers)
    assert desk.answers == [(MINE, 7, False), (MINE, 7, True)]
