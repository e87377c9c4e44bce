"""Checks of a corpus of malformed files: `expected.toml` beside them names, for each, the line and the words of the error."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import InputError


def expectations(corpus: Path) -> dict[str, dict[str, Any]]:
    """The expectations by file name."""
    return tomllib.loads((corpus / "expected.toml").read_text(encoding="utf-8"))


def check_complete(corpus: Path, expected: dict[str, dict[str, Any]]) -> None:
    """Every file has an expectation, and every expectation its file."""
    assert {path.name for path in corpus.iterdir()} == {"expected.toml", *expected}
    assert len(expected) >= 30


def check_refused(load: Callable[[Path], object], path: Path, expected: dict[str, Any], longest: int) -> None:
    """The error is one line that names the place, shorter than `longest` after it, with every word that is expected."""
    with pytest.raises(InputError) as caught:
        load(path)
    message, line = str(caught.value), expected["line"]
    place = f"{path}:{line}: " if line else f"{path}: "
    assert message.startswith(place)
    assert len(message.splitlines()) == 1
    assert len(message) - len(place) < longest
    for word in expected["words"]:
        assert word in message
