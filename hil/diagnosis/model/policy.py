"""The numbers that decide what is said. How finely is looked (grids) stays with the code that looks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Policy:
    """Log odds are natural logarithms.

    named: log odds, its grid paid for, from which a part is there (150 to 1)
    richer: prior log odds against a richer form and a further term of an effect that is there; physics out of its range has twice that
    temperature: divisor of log odds before they become a confidence, since no form is exactly right
    share: part of an effect's RMS that a rough table must leave for it to be told from the table
    correlated: scale of noise that stays from row to row, in white noise: of the half-normal prior on its memory, and of the
        half-Cauchy one on offsets of runs
    few: share of the rows on which no effect may rest alone, unless they are more than `outlier` white noise away
    largest: RMS of an effect over that of the errors, from which another would have to undo it; and its largest value on the travel
        over that on the rows
    sure: posterior of an effect by its column from which its correction goes beyond what was seen
    """

    named: float = 5.0
    richer: float = 3.0
    temperature: float = 2.0
    share: float = 0.33
    correlated: float = 0.4
    few: float = 0.01
    outlier: float = 6.0
    largest: float = 2.0
    sure: float = 0.9


USUAL = Policy()
