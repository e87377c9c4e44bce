"""How well a statement about a drive is founded."""

from __future__ import annotations

from enum import Enum


class Strength(Enum):
    """How well a fact is founded, the strongest first."""

    MAKER = "maker"  # the maker's own text, file or code
    RUN = "run"  # code that somebody ran on the drive, or a record of the drive
    NOTES = "notes"  # notes somebody took from the manual
    ASSUMED = "assumed"  # the source itself assumes it
    GENERAL = "general"  # general knowledge, in no source that was read

    @property
    def is_weak(self) -> bool:
        """Whether it has to be proven on the drive before it is used."""
        return self in (Strength.ASSUMED, Strength.GENERAL)
