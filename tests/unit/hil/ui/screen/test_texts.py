"""Every word in three languages, none outside the text files."""

import ast
import re
from importlib.resources import files
from pathlib import Path
from string import Formatter

import pytest

from drivers.drive import DriveState
from hil.ui.screen.texts import LANGUAGES, Texts, load

HIL = Path(str(files("hil")))
DRAWN = sorted(
    [
        *HIL.glob("app/panel/*.py"),
        *HIL.glob("app/panel/pages/*.py"),
        *HIL.glob("ui/screen/*.py"),
        *HIL.glob("*/page.py"),
    ]
)


def places(text: str) -> set[str]:
    return {name for _, name, _, _ in Formatter().parse(text) if name}


@pytest.mark.parametrize("language", [one for one in LANGUAGES if one != "en"])
def test_the_same_keys_with_the_same_places(language: str) -> None:
    english, other = load("en"), load(language)
    assert sorted(other) == sorted(english)
    assert {key for key in english if places(other[key]) != places(english[key])} == set()


@pytest.mark.parametrize("language", LANGUAGES)
def test_no_text_is_empty(language: str) -> None:
    assert [key for key, text in load(language).items() if not text.strip()] == []


def test_every_key_a_page_names_is_there() -> None:
    """Keys stand as the first argument of what shows a text; an element's name alone is no key."""
    known = load("en")
    for path in DRAWN:
        for call in calls(path):
            called = ast.unparse(call.func)
            if re.fullmatch(r"(view\.|self\.)?(t|value|button|card)", called) and call.args:
                begun = {
                    id(part)
                    for node in ast.walk(call.args[0])
                    if isinstance(node, ast.JoinedStr)
                    for part in node.values
                }
                nodes = [
                    node for node in ast.walk(call.args[0]) if isinstance(node, ast.Constant) and id(node) not in begun
                ]
                keys = [node.value for node in nodes]
                dotted = [key for key in keys if isinstance(key, str) and re.fullmatch(r"\w+\.[\w.]*\w", key)]
                assert [key for key in dotted if key not in known] == [], path.name


def calls(path: Path) -> list[ast.Call]:
    return [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]


@pytest.mark.parametrize("path", DRAWN, ids=lambda path: path.name)
def test_no_words_are_written_into_a_page(path: Path) -> None:
    shown = [
        argument.value
        for call in calls(path)
        if re.fullmatch(
            r"ui\.(label|button|markdown|input|number|link|notify|notification|html)", ast.unparse(call.func)
        )
        for argument in call.args[:1]
        if isinstance(argument, ast.Constant) and isinstance(argument.value, str)
    ]
    assert [text for text in shown if re.search("[A-Za-z]", text)] == []


def test_what_procedures_say_is_said_in_every_language() -> None:
    assert Texts("de").said("run 2 of 5, + → −") == "Lauf 2 von 5, + → −"
    assert Texts("en").said("run 2 of 5, + → −") == "run 2 of 5, + → −"
    one_way = "target 6.18 mm was measured in direction -1 only, expected both directions as at the others"
    assert Texts("de").said(one_way).startswith("Position 6,18 mm nur in Richtung −1 gemessen")
    assert Texts("en").said(one_way) == one_way.replace("-1", "−1")
    assert Texts("zh").said("a drive's own words") == "a drive's own words"


def test_the_states_of_a_drive_are_named_as_in_the_terminal() -> None:
    """There by their names in CiA 402, which every message uses."""
    assert {state.name: Texts("en")(f"state.{state.name}") for state in DriveState} == {
        state.name: state.value for state in DriveState
    }


def test_figures_are_written_as_in_the_language() -> None:
    assert Texts("de").number(-1.25, 2) == "−1,25"
    assert Texts("en").number(1.25, 1, sign=True) == "+1.2"
    assert Texts("en").number(-0.0001, 3) == "0.000"
    assert Texts("zh").number(None) == Texts("zh").number(float("nan")) == "–"
