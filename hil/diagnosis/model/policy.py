"""The numbers that decide what is said. How finely is looked (grids) stays with the code that looks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Policy:
    """Log odds are natural logarithms.

    named: log odds, its grid paid for, from which a part is there (150 to 1)
    richer: prior log odds against a richer form and a further term of an effect that is there; physics out of its range has twice that
    temperature: divisor of log odds before they become a confidence, since no form is exactly right
    unlogged: prior log odds against a cause through a column that was not recorded
    share: part of an effect's RMS that is too little to be told apart: a remainder in its own columns below it is the error of its
        form, and of which a rough table leaves no more is not told from the table
    memory, offset: scales of the half-normal prior on noise with memory and of the half-Cauchy one on offsets of runs, in white noise
    pseudo_rows: rows of average noise that each group of rows has before its own scale is taken
    tail: degrees of freedom of Student's t where the tails are heavy
    few: share of the rows on which no effect may rest alone, unless they are more than `outlier` white noise away; rows of which a
        normal noise has fewer are far off
    largest: RMS of an effect over that of the errors, from which another one would have to undo it
    sure: posterior of an effect by its column from which its correction goes beyond what was seen
    """

    named: float = 5.0
    richer: float = 3.0
    temperature: float = 2.0
    unlogged: float = 1.0
    share: float = 0.33
    memory: float = 0.5
    offset: float = 0.35
    pseudo_rows: float = 10.0
    tail: float = 5.0
    few: float = 0.01
    outlier: float = 6.0
    largest: float = 2.0
    sure: float = 0.9


USUAL = Policy()
