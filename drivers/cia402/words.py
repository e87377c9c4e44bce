"""Words of CiA 402 objects that are no values: "no window", "no limit" (IEC 61800-7-201). The only place that says what they mean."""

from __future__ import annotations

from drivers.scaling import LARGEST_POSITION


def window(word: float | None) -> float | None:
    """6065h, 6067h: None for no window. FFFFFFFFh switches it off; one that reaches over half of all positions decides nothing."""
    return None if word is None or not 0 <= word < LARGEST_POSITION else word


def limit(word: int | None) -> int | None:
    """607Fh, 6080h, 60C5h, 60C6h: None for no limit, which is 0."""
    return word if word is not None and word > 0 else None


def software_limits(low: int, high: int) -> tuple[int, int] | None:
    """607Dh: None for no limits, which are two between which no position lies, such as 0 and 0."""
    return (low, high) if low < high else None
