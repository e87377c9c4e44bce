"""The README keeps its promises: its commands are those that CI runs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from hil.app.main import build_parser

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


DOCS = ROOT / "hil/docs"


def test_the_two_commands() -> None:
    assert re.search(r"^sh hil/bootstrap\.sh hil demo\b", README, re.MULTILINE)
    assert re.search(r"^sh hil/bootstrap\.sh pytest\b", README, re.MULTILINE)


def test_the_number_of_tests_is_about_what_it_says(request: pytest.FixtureRequest) -> None:
    """Counted in this process where it runs them all as the README's command does, else listed by one of its own."""
    said = re.search(r"tests that passed, about (\d+)", README)
    assert said is not None
    config = request.config
    asked = config.args, config.getoption("markexpr"), config.getoption("keyword"), config.getoption("lf", False)
    if asked == (config.getini("testpaths"), "not outside", "", False):
        count = len(request.session.items)
    else:
        words = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-n", "0", "-p", "no:cacheprovider"]
        listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        found = re.search(r"^(\d+)/\d+ tests collected", listed, re.MULTILINE)
        assert found is not None, listed[-500:]
        count = int(found[1])
    assert 0.9 < count / int(said[1]) < 1.1


def test_it_is_short() -> None:
    assert README.count("\n") <= 120
    cells = [cell.strip() for line in README.splitlines() if line.startswith("|") for cell in line.split("|")]
    assert max(len(re.sub(r"\]\([^)]*\)|[`\[]", "", cell)) for cell in cells) <= 100, (
        "two lines of a column as rendered"
    )


def test_its_figures_are_those_that_the_demo_prints() -> None:
    """Outside the blocks, whose output tests/integration/test_docs_commands.py compares, it states no figure of a result."""
    prose = re.sub(r"^```.*?^```$", "", README, flags=re.MULTILINE | re.DOTALL)
    assert not re.findall(r"\d[\d.]* ?(?:µm|%|ms\b|times)", prose)
    assert "```text hil demo\n" in README


def test_the_map_of_the_house_has_every_room() -> None:
    block = re.search(
        r"^```\ndrivers/.*?^```$", (DOCS / "house.md").read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    assert block is not None
    rooms = {path.name for path in (ROOT / "hil").iterdir() if path.is_dir() and any(path.glob("*.py"))}
    for room in rooms - {"examples"}:
        assert f"{room}/ " in block[0], room


def test_every_verb_of_the_readme_exists_and_every_verb_is_in_the_pages() -> None:
    """`hil/docs/verbs.md` has every one, and the README leads there."""
    help_text = build_parser().format_help()
    verbs = set(re.findall(r"^    ([a-z0-9-]+)(?: +\S.*)?$", help_text, re.MULTILINE))
    page = (DOCS / "verbs.md").read_text(encoding="utf-8")
    assert "(hil/docs/verbs.md)" in README
    for verb in verbs:
        assert f"`hil {verb}`" in page, verb
    for verb in re.findall(r"`hil ([a-z0-9-]+)", README):
        assert verb in verbs, verb


def test_top_level_is_exactly_what_was_agreed() -> None:
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split(
        "\n"
    )
    top = {name.split("/")[0] for name in names if name and not name.startswith(".")}
    assert top <= {"pyproject.toml", "hil", "drivers", "sim_backends", "tests", "README.md"}
