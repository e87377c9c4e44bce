"""Settings of the passes in motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import InputError


@dataclass(frozen=True)
class InMotion:
    """Settings of the passes.

    feeds_mm_s: at each, up and down in every run; stretch_mm: of constant velocity; rows: kept of each pass, evenly
    spaced
    latency_s: of the instrument, see `hil.figures.latency`, None: unknown; dated_by: how it is known, in words; lag_mm:
    allowed distance of the axis behind its set-point
    trigger_input: input of the drive that captures positions at edges shared with the instrument, None: on the fly
    """

    feeds_mm_s: tuple[float, ...]
    runs: int = 4
    rows: int = 10
    stretch_mm: float = 80.0
    acceleration_mm_s2: float = 400.0
    period_s: float = 0.002
    latency_s: float | None = 0.0
    dated_by: str = ""
    trigger_input: int | None = None
    lag_mm: float = 2.0


def feeds_of(text: str) -> tuple[float, ...]:
    """Feeds, mm/s, from text: at least two, separated by commas, or by semicolons where a comma is a decimal mark.
    Raises InputError.
    """
    parts = text.replace(",", ".").split(";") if ";" in text else text.split(",")
    try:
        found = tuple(float(part) for part in parts)
    except ValueError:
        found = ()
    if len(set(found)) < 2 or not all(0 < feed < math.inf for feed in found):
        raise InputError(f"{text!r}, expected at least two different feeds above 0 mm/s, e.g. 20,60,110")
    return found
