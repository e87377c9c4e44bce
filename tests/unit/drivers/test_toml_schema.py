"""The one reader of TOML files: the line of every part of a document, and every kind of refusal with file, line and key."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.toml_lines import lines_of
from drivers.toml_schema import Document, shown
from drivers.toml_types import File, Key, Limits, Name, Positive, Ratio, SchemaError, Text, Via, not_empty, one_of

ROOT = Path(__file__).parents[3]
FILES = [path for folder in ("drivers", "hil") for path in sorted((ROOT / folder).rglob("*.toml"))]

DOCUMENT = '''\
title = "a # b = c"   # d = 1
a.b = 1
[x."y z"]
list = [ { a = 1, b = [1,
2] },
  # { no = 1 },
  { c = """
[not] = a table
""" } ]
[[p]]
k = 1.5
[[p]]
[p.s]
day = 1979-05-27T07:32:00Z
[[p.r]]
e.f = { g = 'x', h = [] }
'''
LINES = {
    ("title",): 1,
    ("a",): 2,
    ("a", "b"): 2,
    ("x",): 3,
    ("x", "y z"): 3,
    ("x", "y z", "list"): 4,
    ("x", "y z", "list", 0): 4,
    ("x", "y z", "list", 0, "a"): 4,
    ("x", "y z", "list", 0, "b"): 4,
    ("x", "y z", "list", 0, "b", 0): 4,
    ("x", "y z", "list", 0, "b", 1): 5,
    ("x", "y z", "list", 1): 7,
    ("x", "y z", "list", 1, "c"): 7,
    ("p",): 10,
    ("p", 0): 10,
    ("p", 0, "k"): 11,
    ("p", 1): 12,
    ("p", 1, "s"): 13,
    ("p", 1, "s", "day"): 14,
    ("p", 1, "r"): 15,
    ("p", 1, "r", 0): 15,
    ("p", 1, "r", 0, "e"): 16,
    ("p", 1, "r", 0, "e", "f"): 16,
    ("p", 1, "r", 0, "e", "f", "g"): 16,
    ("p", 1, "r", 0, "e", "f", "h"): 16,
}


def places(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    if place:
        yield place
    members = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for name, each in members:
        yield from places(each, (*place, name))


def test_the_line_of_each_part() -> None:
    assert lines_of(DOCUMENT) == LINES
    assert set(places(tomllib.loads(DOCUMENT))) == set(LINES)


@pytest.mark.parametrize("path", FILES, ids=[path.name for path in FILES])
def test_every_part_of_every_file_we_ship_has_the_line_that_names_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    found, written = lines_of(text), text.splitlines()
    assert set(found) == set(places(tomllib.loads(text)))
    for place, line in found.items():
        key = next(part for part in reversed(place) if isinstance(part, str))
        assert isinstance(place[-1], int) or key in written[line - 1]


@given(
    st.lists(
        st.sampled_from(["\n", "# x = [", 'a = "]"', "[{", "'''\n[t]\n'''", "{ b = 1 }", "1,", "]", "\\"]), max_size=8
    )
)
@settings(max_examples=300)
def test_any_valid_document_is_scanned_to_its_end(parts: list[str]) -> None:
    text = "k = [" + "\n".join(parts) + "\n]\nlast = 1\n"
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        return
    found = lines_of(text)
    assert set(found) == set(places(values))
    assert found["last",] == text.count("\n")


# -- schemas -------------------------------------------------------------------------------------------------------------
class Mode(Enum):
    FAST = "fast"
    SLOW = "slow"


@dataclass(frozen=True)
class Inner:
    speed_mm_s: Positive
    steps: Annotated[int, Limits(ge=1, le=9)] = 3
    mode: Mode = Mode.FAST
    sign: Annotated[int, one_of(1, -1)] = 1

    def __post_init__(self) -> None:
        if self.steps > 5 and self.mode is Mode.FAST:
            raise SchemaError("steps", f"is {self.steps}, expected at most 5 when fast")


def _even(value: int, _: Document) -> int:
    if value % 2:
        raise ValueError
    return value


def _within(value: int, document: Document) -> int:
    if value > document.context:
        raise SchemaError("", f"is {value}, expected at most {document.context}")
    return value


@dataclass(frozen=True)
class Outer:
    name: Name
    inner: Inner
    more: tuple[Inner, ...] = ()
    by_name: dict[Name, Inner] = field(default_factory=dict)
    pair: Annotated[tuple[float, float] | None, Key("pair_mm")] = None
    file: File | None = None
    ratio: Ratio | None = None
    flag: bool = False
    words: Annotated[tuple[Text, ...], not_empty] = ("a",)
    even: Annotated[int, _even, Limits(description="an even number")] = 0
    small: Annotated[int, _within] = 0
    either: Annotated[float, Via(float | Inner, lambda each, _: getattr(each, "speed_mm_s", each))] = 0.0
    hidden: Annotated[int, Key("")] = 7


GOOD = 'name = "N"\n[inner]\nspeed_mm_s = 2\n'


def load(text: str) -> Outer:
    return Document("dir/f.toml", text, context=10).load(Outer)


def test_what_is_written_is_what_is_read() -> None:
    text = (
        'name = "N"\npair_mm = [1, 2.5]\nfile = "x.eds"\nratio = "5/2"\nwords = ["b"]\neven = 4\nsmall = 10\n'
        "either = { speed_mm_s = 4 }\n[inner]\nspeed_mm_s = 2\nmode = 'slow'\nsteps = 9\n"
        "[[more]]\nspeed_mm_s = 3\nsign = -1\n[by_name.a]\nspeed_mm_s = 1.5\n"
    )
    found = load(text)
    assert found.inner == Inner(2.0, 9, Mode.SLOW)
    assert found.more == (Inner(3.0, sign=-1),)
    assert found.by_name == {"a": Inner(1.5)}
    assert (found.pair, found.ratio, found.words, found.even) == ((1.0, 2.5), 2.5, ("b",), 4)
    assert found.file == Path("dir").resolve() / "x.eds"
    assert (found.either, found.hidden, found.small) == (4.0, 7, 10)
    assert load('name = "N"\ninner = { speed_mm_s = 1 }\nmore = { speed_mm_s = 2 }').more == (Inner(2.0),), "one alone"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('name = "N"', "lacks the table [inner]"),
        ("[inner]\nspeed_mm_s = 1", "lacks name, expected a name of letters, digits, _ . -"),
        ('name = "N"\n[inner]\nsteps = 2', "2: [inner] lacks speed_mm_s, expected a number > 0 in mm/s"),
        ('name = "N"\ninner = 5', "2: [inner] is 5, expected a table"),
        (GOOD + "spede_mm_s = 3", "4: [inner] unknown key spede_mm_s, the nearest known one is speed_mm_s"),
        (GOOD + "zzz = 3", "4: [inner] unknown key zzz, expected one of mode, sign, speed_mm_s, steps"),
        ("hidden = 3\n" + GOOD, "1: unknown key hidden, expected one of by_name, either, even,"),
        (GOOD.replace("2", "0"), "3: [inner] speed_mm_s is 0, expected a number > 0 in mm/s"),
        (GOOD.replace("2", "nan"), "3: [inner] speed_mm_s is nan, expected a number > 0 in mm/s"),
        (GOOD.replace("2", "1e10"), "3: [inner] speed_mm_s is 10000000000.0, expected a number > 0 in mm/s"),
        (GOOD.replace("2", "true"), "3: [inner] speed_mm_s is True, expected a number > 0 in mm/s"),
        (GOOD + "steps = 2.0", "4: [inner] steps is 2.0, expected a whole number, 1 to 9"),
        (GOOD + "steps = 10", "4: [inner] steps is 10, expected a whole number, 1 to 9"),
        (GOOD + "steps = true", "4: [inner] steps is True, expected a whole number, 1 to 9"),
        (GOOD + "mode = 'quick'", "4: [inner] mode is quick, expected fast or slow"),
        (GOOD + "sign = 1.0", "4: [inner] sign is 1.0, expected 1 or -1"),
        (GOOD + "sign = true", "4: [inner] sign is True, expected 1 or -1"),
        (GOOD + "# why\nsteps = 6", "5: [inner] steps is 6, expected at most 5 when fast"),
        (GOOD + "[[more]]\nspeed_mm_s = 1\n[[more]]\nsteps = 1", "6: [more[1]] lacks speed_mm_s, expected"),
        (GOOD + "[by_name.b]\nspeed_mm_s = 1\nsteps = 0", "6: [by_name.b] steps is 0, expected"),
        (GOOD + "[by_name.'b c']\nspeed_mm_s = 1", "4: [by_name] b c is 'b c', expected a name"),
        ("more = [{ speed_mm_s = 1 },\n 3]\n" + GOOD, "2: more[1] is 3, expected a table"),
        ("more = 3\n" + GOOD, "1: more is 3, expected a list of tables"),
        ("pair_mm = [1]\n" + GOOD, "1: pair_mm is [1], expected a list of 2, each mm"),
        ("pair_mm = [1,\n 'x']\n" + GOOD, "2: pair_mm[1] is x, expected mm"),
        ("file = ' '\n" + GOOD, "1: file is ' ', expected a file"),
        ("ratio = '1/0'\n" + GOOD, "1: ratio is '1/0', expected a whole number or a fraction"),
        ("flag = 1\n" + GOOD, "1: flag is 1, expected true or false"),
        ("words = []\n" + GOOD, "1: words is [], expected a list, each a text"),
        ("even = 3\n" + GOOD, "1: even is 3, expected an even number"),
        ("small = 11\n" + GOOD, "1: small is 11, expected at most 10"),
        ("either = { steps = 1 }\n" + GOOD, "1: [either] lacks speed_mm_s, expected a number > 0 in mm/s"),
    ],
)
def test_what_is_wrong_is_said_with_line_key_value_and_expectation(text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        load(text)
    assert said in str(caught.value)
    assert str(caught.value).startswith("dir/f.toml:")
    assert "\n" not in str(caught.value)


def test_tables_of_a_file_one_by_one() -> None:
    document = Document("f.toml", "[a]\nspeed_mm_s = 1\nname = 'N'\nodd = 1\n[b]\n")
    assert document.load(Inner, "b", usual={"speed_mm_s": 9.0}) == Inner(9.0)
    assert document.load(Inner, "c", usual={"speed_mm_s": 9.0}, required=False) == Inner(9.0)
    with pytest.raises(InputError, match=r"f\.toml: lacks the table \[c\]"):
        document.load(Inner, "c")
    with pytest.raises(InputError, match=r":3: \[a\] unknown key name"):
        document.load(Inner, "a")
    with pytest.raises(InputError, match=r":4: \[a\] unknown key odd"):
        document.load(Inner, "a", beside=[Outer])
    with pytest.raises(InputError, match=r":2: \[a\] unknown key speed_mm_s"):
        document.load(Inner, "a", only=["mode"], usual={"speed_mm_s": 1.0})
    with pytest.raises(InputError, match=r":5: \[b\] lacks mode, expected fast or slow"):
        document.load(Inner, "b", usual={"speed_mm_s": 9.0}, needs=["mode"])
    document.finish()
    other = Document("f.toml", "[a]\n[bb]\n")
    other.load(Inner, "b", usual={"speed_mm_s": 1.0}, required=False)
    with pytest.raises(InputError, match=r":1: unknown key a, expected one of b"):
        other.finish()


def test_a_wrong_value_is_quoted_on_one_line_and_not_all_of_it() -> None:
    assert shown("word") == "word"
    assert shown("two\nlines") == "'two\\nlines'"
    assert len(shown("x" * 99 + " ")) == 61
    assert shown(10**6000) == "a number of thousands of digits"
