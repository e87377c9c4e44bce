"""The README keeps its promises: its commands are those that CI runs, its script is the one that is shipped."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

from hil.app.terminal.main import build_parser

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_script_in_the_readme_is_the_shipped_one() -> None:
    shipped = (ROOT / "hil/examples/commission.py").read_text(encoding="utf-8").split('"""\n', 1)[1].strip()
    assert f"```python\n{shipped}\n```" in README


def test_the_two_commands() -> None:
    assert re.search(r"^sh hil/bootstrap\.sh hil demo\b", README, re.MULTILINE)
    assert re.search(r"^sh hil/bootstrap\.sh pytest\b", README, re.MULTILINE)


def test_every_verb_of_the_readme_exists_and_every_verb_is_in_it() -> None:
    help_text = build_parser().format_help()
    verbs = set(re.findall(r"^    ([a-z0-9-]+)(?: +\S.*)?$", help_text, re.MULTILINE))
    for verb in verbs:
        assert f"hil {verb}" in README or f"`{verb}`" in README, verb
    for verb in re.findall(r"`hil ([a-z0-9-]+)", README):
        assert verb in verbs, verb


def test_top_level_is_exactly_what_was_agreed() -> None:
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split(
        "\n"
    )
    top = {name.split("/")[0] for name in names if name and not name.startswith(".")}
    assert top <= {"pyproject.toml", "hil", "drivers", "sim_backends", "tests", "README.md"}
