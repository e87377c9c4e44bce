"""Words set in lines of a given width, and columns that share one: what paper needs and a browser does by itself.

Widths and sizes are in inches, sizes of letters in points. Measures with matplotlib's own fonts, inside `svg.drawing_settings`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from hil.app.report.data import plain

PT_PER_IN = 72.0


@dataclass(frozen=True)
class Letters:
    """How words look."""

    size_pt: float
    color: str
    bold: bool = False
    mono: bool = False

    @property
    def line_in(self) -> float:
        """From one line to the next."""
        return 1.38 * self.size_pt / PT_PER_IN

    @property
    def font(self) -> FontProperties:
        return _font(self.size_pt, self.bold, self.mono)

    def width_in(self, text: str) -> float:
        return _width_in(text, self.bold, self.mono) * self.size_pt


@lru_cache(maxsize=64)
def _font(size_pt: float, bold: bool, mono: bool) -> FontProperties:
    family = "DejaVu Sans Mono" if mono else "DejaVu Sans"
    return FontProperties(family=[family], weight="bold" if bold else "normal", size=size_pt)


@lru_cache(maxsize=20_000)
def _width_in(text: str, bold: bool, mono: bool) -> float:
    """Of letters of one point."""
    width, _, _ = text_to_path.get_text_width_height_descent(text, _font(10.0, bold, mono), ismath=False)
    return float(width) / 10.0 / PT_PER_IN


def wrapped(text: str, letters: Letters, width_in: float) -> list[str]:
    """The lines of a text; a word that is too long for one is cut where the line ends. Always one line at least."""
    lines: list[str] = []
    line = ""
    for word in plain(text).split():
        rest = word
        if line and letters.width_in(f"{line} {rest}") <= width_in:
            line = f"{line} {rest}"
            continue
        if line:
            lines.append(line)
        while len(rest) > 1 and letters.width_in(rest) > width_in:
            fitting = _fitting(rest, letters, width_in)
            lines.append(rest[:fitting])
            rest = rest[fitting:]
        line = rest
    return [*lines, line] if line or not lines else lines


def _fitting(word: str, letters: Letters, width_in: float) -> int:
    """How many letters of a word fit, one at least."""
    low, high = 1, len(word)
    while low < high:
        middle = (low + high + 1) // 2
        low, high = (middle, high) if letters.width_in(word[:middle]) <= width_in else (low, middle - 1)
    return low


def shared(wanted_in: Sequence[float], width_in: float) -> list[float]:
    """What each column gets of a width: what it wants, where there is enough; else the widest give way to one common width."""
    if sum(wanted_in) <= width_in:
        return list(wanted_in)
    narrow = np.sort(np.asarray(wanted_in, dtype=np.float64))
    left, columns = width_in, len(narrow)
    for index, wanted in enumerate(narrow):
        common = left / (columns - index)
        if wanted > common:
            return [min(one, float(common)) for one in wanted_in]
        left -= float(wanted)
    return list(wanted_in)


def groups(wanted_in: Sequence[float], width_in: float) -> list[list[int]]:
    """Columns that do not give way, as many side by side as fit: their indices, the first column in every group."""
    found: list[list[int]] = []
    for index in range(1, len(wanted_in)):
        taken = wanted_in[0] + sum(wanted_in[one] for one in found[-1][1:]) if found else width_in
        if not found or taken + wanted_in[index] > width_in:
            found.append([0])
        found[-1].append(index)
    return found or [[0]]
