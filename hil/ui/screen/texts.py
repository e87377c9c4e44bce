"""The texts of the screen in three languages: one file each, with the same keys.

Messages of procedures and drives are English in terminals, journals and reports. `[said]` holds them as patterns: the English text is
the message, the other languages are its translation; the parts of a message are translated in the same way. A message without a
pattern, such as an error's, is shown in English.
"""

from __future__ import annotations

import math
import re
import tomllib
from decimal import Decimal
from functools import cache
from importlib.resources import files
from typing import Any

LANGUAGES = {"en": "English", "de": "Deutsch", "zh": "中文"}
SAID = "said"
FIGURES = re.compile(r"-?\d+(\.\d+)?(, -?\d+(\.\d+)?)*( ± \d+(\.\d+)?)?")
"""A number, several, or one with its uncertainty, as procedures write them."""
WEIGHTS = re.compile(r"\w+ [01]\.\d\d(, \w+ [01]\.\d\d)*")
"""Effects with their weights."""
COLUMNS = re.compile(r"\w+( × \w+)*(; \w+( × \w+)*)*")
"""Columns that something depends on."""
NAMES = {re.compile(r"temp_(?P<place>\w+)_c"): "column.temp", re.compile(r"pos_(?P<axis>\w+)_mm"): "column.pos"}
"""Columns that are named after what they are of."""


class Texts:
    """The texts of one language."""

    def __init__(self, language: str) -> None:
        self.language = language
        self._texts = load(language)

    def __call__(self, key: str, **figures: object) -> str:
        """The text of a key, its {places} filled. Raises KeyError for a key that is not there."""
        return self._texts[key].format(**figures) if figures else self._texts[key]

    def known(self, table: str, name: str) -> str:
        """The text of a name in a table of names; the name itself where it is not in the table."""
        return self._texts.get(f"{table}.{name}", name)

    def measurement(self, name: str, of: str = "") -> str:
        """A measurement of a campaign as a person names it: "round-2" by what it is and its number; itself where it is not known. of:
        kind of the job, where it calls by that name what others call otherwise."""
        own = f"pass.{of.replace(' ', '_').replace('-', '_')}_{name}"
        if own in self:
            return self(own)
        kind, _, number = name.rpartition("-")
        if number.isdecimal() and f"pass.{kind}" in self:
            return self(f"pass.{kind}", number=number)
        return self(f"pass.{name}", number="") if f"pass.{name}" in self else self.said(name)

    def __contains__(self, key: str) -> bool:
        return key in self._texts

    def said(self, text: str) -> str:
        """A procedure's message in this language, with its parts; unchanged without a pattern."""
        for key, pattern in _patterns():
            match = pattern.fullmatch(text)
            if match is not None:
                return self._with_parts(key, match)
        return self._named(text)

    def _with_parts(self, key: str, match: re.Match[str]) -> str:
        return self._texts[key].format(**{name: self.said(part) for name, part in match.groupdict().items()})

    def _named(self, text: str) -> str:
        """Names of effects and columns, and figures, in this language; anything else unchanged."""
        if FIGURES.fullmatch(text):
            return self._written(text.replace(", ", "; ") if self.language == "de" else text)
        if WEIGHTS.fullmatch(text):
            return "; ".join(" ".join(map(self.said, one.split())) for one in text.split(", "))
        if COLUMNS.fullmatch(text) and not text.isidentifier():
            return re.sub(r"\w+", lambda name: self._named(name[0]), text)
        for pattern, key in NAMES.items():
            if match := pattern.fullmatch(text):
                return self._with_parts(key, match)
        return self._texts.get(f"effect.{text}") or self._texts.get(f"column.{text}", text)

    def _written(self, figure: str) -> str:
        figure = figure.replace("-", "−")
        return figure.replace(".", ",") if self.language == "de" else figure

    def number(self, value: float | None, digits: int = 3, *, sign: bool = False) -> str:
        """A figure in this language's notation; a dash for None and NaN."""
        if value is None or math.isnan(value):
            return "–"
        rounded = round(value, digits) + 0.0  # no −0.0
        return self._written(f"{rounded:{'+' if sign else ''}.{digits}f}")

    def significant(self, value: float | None, digits: int = 4) -> str:
        """A figure to so many significant digits, without an exponent; a dash for None, NaN and infinity."""
        if value is None or not math.isfinite(value):
            return "–"
        return self._written(f"{Decimal(f'{value:.{digits}g}'):f}")

    def estimate(
        self, value: float | None, std: float | None, unit: str = "", ends: tuple[float, float] | None = None
    ) -> str:
        """A figure with the expanded uncertainty (k = 2) of its standard one, or the ends of its interval, and its unit."""
        if ends is not None:
            return f"{self.significant(value)} ({' … '.join(map(self.significant, ends))}) {unit}".rstrip()
        spread = "" if not std or not math.isfinite(std) else f" ± {self.significant(2.0 * std, 2)}"
        return f"{self.significant(value)}{spread} {unit}".rstrip()


@cache
def load(language: str) -> dict[str, str]:
    """Key ("page.what") -> text of one language."""
    text = files("hil.ui.screen").joinpath("texts", f"{language}.toml").read_text(encoding="utf-8")
    return dict(_flat(tomllib.loads(text), ""))


def _flat(table: dict[str, Any], prefix: str) -> list[tuple[str, str]]:
    found: list[tuple[str, str]] = []
    for key, value in table.items():
        found += _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else [(prefix + key, str(value))]
    return found


@cache
def _patterns() -> tuple[tuple[str, re.Pattern[str]], ...]:
    """The English messages as patterns with a group for each {place}."""
    said = [(key, text) for key, text in load("en").items() if key.startswith(f"{SAID}.")]
    return tuple((key, re.compile(re.sub(r"\\{(\w+)\\}", r"(?P<\1>.+)", re.escape(text)))) for key, text in said)
