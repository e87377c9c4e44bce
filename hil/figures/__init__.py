"""Figures computed from rows (ISO 230-2, uncertainty, latency, alignment of the beam) and their history over months."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

FIGURES: Mapping[str, str] = MappingProxyType(
    {
        "A": "bi-directional accuracy of positioning",
        "A_up": "unidirectional accuracy, direction +",
        "A_down": "unidirectional accuracy, direction -",
        "E": "bi-directional systematic deviation",
        "E_up": "unidirectional systematic deviation, direction +",
        "E_down": "unidirectional systematic deviation, direction -",
        "M": "mean bi-directional positional deviation (range)",
        "R": "bi-directional repeatability",
        "R_up": "unidirectional repeatability, direction +",
        "R_down": "unidirectional repeatability, direction -",
        "B": "reversal value",
        "B_mean": "mean reversal value (signed)",
    }
)
"""Name of each figure of an axis, in the order of display, and the standard's term for it."""
