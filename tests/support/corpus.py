"""A corpus of malformed files: `expected.toml` beside them says, for each, the line that is blamed and the words of the refusal."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import InputError


def expectations(corpus: Path) -> dict[str, dict[str, Any]]:
    """By file name."""
    return tomllib.loads((corpus / "expected.toml").read_text(encoding="utf-8"))


def check_complete(corpus: Path, expected: dict[str, dict[str, Any]]) -> None:
    """Every file is expected, every expectation has its file."""
    assert {path.name for path in corpus.iterdir()} == {"expected.toml", *expected}
    assert len(expected) >= 30


def check_refused(load: Callable[[Path], object], path: Path, expected: dict[str, Any], longest: int) -> None:
    """One line that names the place, shorter than `longest` behind it, with every word that is expected."""
    with pytest.raises(InputError) as caught:
        load(path)
    message, line = str(caught.value), expected["line"]
    place = f"{path}:{line}: " if line else f"{path}: "
    assert message.startswith(place)
    assert len(message.splitlines()) == 1
    assert len(message) - len(place) < longest
    for word in expected["words"]:
        assert word in message
