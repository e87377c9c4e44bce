"""Every word of the screen, in three languages: one file each, the same keys in all.

`[said]` holds what procedures say, as patterns: the English one is what they say, the others how it is said there. What is not in it,
such as a drive's own error, is shown as it came.
"""

from __future__ import annotations

import math
import re
import tomllib
from functools import cache
from importlib.resources import files
from typing import Any

LANGUAGES = {"en": "English", "de": "Deutsch", "zh": "中文"}
SAID = "said"


class Texts:
    """The texts of one language."""

    def __init__(self, language: str) -> None:
        self.language = language
        self._texts = load(language)

    def __call__(self, key: str, **figures: object) -> str:
        """The text of a key, its {places} filled. Raises KeyError for a key that is not there."""
        return self._texts[key].format(**figures) if figures else self._texts[key]

    def known(self, table: str, name: str) -> str:
        """The text of a name in a table of names; a name that is not in it stands for itself."""
        return self._texts.get(f"{table}.{name}", name)

    def said(self, text: str) -> str:
        """What a procedure said, in this language where it is known."""
        for key, pattern in _patterns():
            match = pattern.fullmatch(text)
            if match is not None:
                return self._texts[key].format(**match.groupdict())
        return text

    def number(self, value: float | None, digits: int = 3, *, sign: bool = False) -> str:
        """A figure as it is written in this language; a dash for one that is not known."""
        if value is None or math.isnan(value):
            return "–"
        rounded = round(value, digits) + 0.0  # no −0.0
        text = f"{rounded:{'+' if sign else ''}.{digits}f}".replace("-", "−")
        return text.replace(".", ",") if self.language == "de" else text


@cache
def load(language: str) -> dict[str, str]:
    """Key ("page.what") -> text of one language."""
    text = files("hil.panel").joinpath("texts", f"{language}.toml").read_text(encoding="utf-8")
    return dict(_flat(tomllib.loads(text), ""))


def _flat(table: dict[str, Any], prefix: str) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for key, value in table.items():
        found += _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else [(prefix + key, str(value))]
    return found


@cache
def _patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    """What is said in English, as patterns with a group for each {place}."""
    said = [(key, text) for key, text in load("en").items() if key.startswith(f"{SAID}.")]
    return tuple((key, re.compile(re.sub(r"\\{(\w+)\\}", r"(?P<\1>.+)", re.escape(text)))) for key, text in said)
