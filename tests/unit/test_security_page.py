"""The security page: each attack names a test that is there, and the bounds are those of the code."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from fuzz.targets import TARGETS

import drivers.instruments.replay as recordings
from drivers import files as outside_files
from drivers import toml_schema
from drivers.canopen import eds, eds_text
from drivers.instruments import ascii_values, nd2xx, umd
from hil.correction.sealed import container, keys
from hil.records import files
from hil.ui.terminal import passwords

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "hil/docs/security.md").read_text(encoding="utf-8")
CITED = re.findall(r"`([\w./]+\.py)::(\w+)`", PAGE)


@pytest.mark.parametrize(("path", "name"), CITED, ids=[name for _, name in CITED])
def test_a_cited_test_is_there(path: str, name: str) -> None:
    assert re.search(rf"^def {name}\(", (ROOT / "tests" / path).read_text(encoding="utf-8"), re.M)


def test_every_attack_names_its_test() -> None:
    attacks = PAGE.partition("## Attacks tried")[2].partition("## Bounds")[0].split("\n- ")[1:]
    assert len(attacks) > 20
    assert all(re.search(r"`[\w./]+\.py::\w+`", attack) for attack in attacks)
    assert len(CITED) > 45


def test_the_bounds_are_those_of_the_code() -> None:
    assert keys.MAX_KEY_FILE_BYTES == 64 << 10
    assert (container.MAX_KDF_MEMORY_BYTES, container.MAX_KDF_WORK, keys.MAX_ROUNDS) == (256 << 20, 1 << 23, 1 << 22)
    assert (container.MAX_HEADER_BYTES, container.MAX_BINDING_BYTES, container.MAX_ENTRIES) == (1 << 20, 32 << 10, 1000)
    assert (recordings.MOST_BYTES, recordings.MOST_LINES, recordings.MOST_CELLS) == (256 << 20, 1 << 22, 1 << 24)
    assert (files.DEEPEST, files.MOST_DIGITS, eds.MOST_DIGITS) == (64, 64, 64)
    assert toml_schema.MOST_BYTES == 4 << 20
    assert (outside_files.MOST_BYTES, eds.MOST_BYTES, eds_text.MOST_MEMBERS) == (256 << 20, 16 << 20, 1 << 14)
    assert passwords.MOST_BYTES == 1 << 20
    assert (ascii_values.LONGEST_BYTES, umd.MAX_LINE_BYTES, nd2xx.LONGEST_BYTES) == (200, 400, 40)


def test_every_target_of_the_fuzzing_was_run_and_the_page_has_their_sum() -> None:
    counts = json.loads((ROOT / "tests/fuzz/counts.json").read_text(encoding="utf-8"))
    assert set(counts) == set(TARGETS)
    assert f"{sum(counts.values()):,} on {len(counts)} targets, at least {min(counts.values()):,} on each" in PAGE
