"""Lines in which a gauge sends its value as text: their units, the shipped patterns, and the check of others. No I/O."""

from __future__ import annotations

import re

from drivers.toml_types import SchemaError

MM: dict[str, float] = {
    "mm": 1.0, "um": 1e-3, "\N{GREEK SMALL LETTER MU}m": 1e-3, "in": 25.4, "inch": 25.4, "inches": 25.4, '"': 25.4
}  # fmt: skip
"""Unit, case-folded (the micro sign becomes a mu), -> mm."""
PATTERNS: dict[str, str] = {
    "mitutoyo": r"0\dA(?P<value>[+-](?=[\d.]{8}$)\d+\.\d+)",
    "number": r"\s*+(?P<value>[+-]?\s*+\d+(\.\d+)?)\s*+(?P<unit>mm|um|\N{GREEK SMALL LETTER MU}m|in|inch|inches|\")?\s*",
}
EXPECTED = r"number, mitutoyo, or a regular expression such as '(?P<value>[+-]\d+\.\d{4}) (?P<unit>mm|in)'"
"""What a pattern has to be, for errors."""


def value_pattern(pattern: str) -> re.Pattern[str]:
    """pattern: the name of a shipped one, or a regular expression. Raises SchemaError for one that cannot work."""
    compiled = _compiled("pattern", PATTERNS.get(pattern, pattern), f", expected {EXPECTED}")
    if "value" not in compiled.groupindex:
        raise SchemaError("pattern", f"is {pattern!r} and has no group for the number, expected {EXPECTED}")
    return compiled


def fault_pattern(fault: str) -> re.Pattern[str] | None:
    """Of the lines that report 'no value'; "" for none. Raises SchemaError for no regular expression."""
    return _compiled("fault", fault) if fault else None


def _compiled(key: str, pattern: str, expected: str = "") -> re.Pattern[str]:
    try:
        return re.compile(pattern, re.IGNORECASE)
    except (re.error, RecursionError, OverflowError) as error:
        raise SchemaError(key, f"is {pattern!r}, which is no regular expression: {error}{expected}") from error
