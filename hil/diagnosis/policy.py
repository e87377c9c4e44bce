"""Every hand-set number of the verdict, in one place: its unit, what it decides, and where it comes from.

`policy()` gives the one in force. `python tests/study/policy.py` halves and doubles each, or switches its rule off, and prints how
the verdicts on random machines move; what it printed stands in `hil/docs/policy.md`. Grids, rounds and limits of memory decide how
thorough the search is, not what is said; they stay with the code that uses them. Bounds of a cause itself (a screw's expansion, the
width of a worn zone) are in its effect.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, fields


def _number(value: float, unit: str, meaning: str, origin: str) -> float:
    number: float = field(default=value, metadata={"unit": unit, "meaning": meaning, "origin": origin})
    return number


LOG = "log odds"
SHARE = "1"
RATE = "probability"
NOISE = "noise std"


@dataclass(frozen=True)
class Policy:
    """The numbers; `Policy.table()` lists them with unit, meaning and origin."""

    # -- what is significant ---------------------------------------------------------------------------------------------
    false_findings: float = _number(
        0.005,
        RATE,
        "in noise of a finding, over the whole catalogue, of a wave along a few rows, of a column that rows far off follow, and of a"
        " note that more is left",
        "half of the 1 % asked for; of 185 weak causes two more are named than with 0.003",
    )
    false_structure: float = _number(
        0.002, RATE, "of a structure outside the catalogue on such a campaign", "asked for: anything said at most 2.5 %"
    )
    accepted_from: float = _number(35.0, LOG, "taken without simulating noise", "e^-35 is below any rate asked for")
    # -- which of several ------------------------------------------------------------------------------------------------
    temperature: float = _number(
        2.0, SHARE, "divisor of log odds before they become confidences: no form is exactly right", "set by hand"
    )
    positive: float = _number(
        2.0,
        LOG,
        "by which another effect must be better to take the place, and against none from which noise is simulated for one, or an"
        " unproven one is considered",
        "7 to 1; 1 to 3 is called positive by Kass & Raftery, J. Am. Stat. Assoc. 90, 1995",
    )
    strong: float = _number(
        3.0,
        LOG,
        "of a richer form against the simplest, half of what a run must promise to separate two causes, of a term beside those taken"
        " after it, of each further effect of several in place of a wandering reading, of a smooth"
        " function of other columns against an effect, and between noise models",
        "20 to 1; the same: 3 to 5 is strong",
    )
    very_strong: float = _number(
        5.0,
        LOG,
        "against implausible parameters, and of a temperature against a course of time, below which the two are not told apart",
        "150 to 1; the same: beyond 5 is very strong",
    )
    decisive: float = _number(
        6.0,
        LOG,
        "of a term beside an unexplained structure, of such a structure or a pair of effects against a term, of strong memory of rows,"
        " and of noise that grows with the speed",
        "400 to 1: structures and noise have more freedom than a cause; of 22 tuning machines with a slow cause no pair came beyond 2",
    )
    unsimulated: float = _number(
        12.0,
        LOG,
        "by which a pair of effects must exceed none, where neither was found by itself, and with a run left out any effect, where no"
        " noise was simulated",
        "160 000 to 1: 40 000 to 100 000 pairs are tried; of 500 machines without a cause none came so far",
    )
    no_further: float = _number(
        2.5,
        LOG,
        "of such a temperature below which the correction goes no further than it was seen",
        "12 to 1, from 10 machines of the study; of 20 others below it 12 followed a temperature all the same (decision 0027)",
    )
    worst: float = _number(
        -12.0, LOG, "least of a cause in one part of the records", "set by hand: no form is exactly right"
    )
    # -- shares ----------------------------------------------------------------------------------------------------------
    in_table: float = _number(
        0.5,
        SHARE,
        "of an effect of position and direction that must be left beside the table, else its name is in doubt",
        "tuning seeds: 2 of 3 sure cyclic errors below it were wrong, 0 of 20 above",
    )
    blind: float = _number(
        0.01,
        SHARE,
        "of a candidate's norm that must be left beside the table to be seen",
        "a hundredth of it is rounding of forms",
    )
    shape: float = _number(
        0.35,
        SHARE,
        "of an effect below which what is left in its own columns is its form, and of the largest part left below which another is the"
        " rest of its waves",
        "forms of the study differ so much",
    )
    outgrown: float = _number(
        0.7, SHARE, "of an effect above which a structure of its columns is the cause", "half of the power"
    )
    equivalent: float = _number(
        0.9,
        SHARE,
        "of a column's variance by another's cubic from which the two are one",
        "an earlier trial: a correlation of 0.95",
    )
    slow_alike: float = _number(
        0.65,
        SHARE,
        "of the evidence along a slow column that another slow one in its place keeps, from which that may carry it",
        "tuning seeds 103000 to 103042: the columns of 37 of 41 causes are named, not of 32, with 3.8 in place of 2.8 named as"
        " equivalent; at 0.5 of 37 with 4.4, at 0.8 of 33; a load set anew per run keeps 0.5",
    )
    still: float = _number(0.15, SHARE, "of a course in time that must be left beside a table", "set by hand")
    few_rows: float = _number(
        0.01,
        SHARE,
        "of the rows, without which a finding must still be likelier than none",
        "share of outliers in heavy tails",
    )
    trimmed: float = _number(
        5.0,
        "folds",
        "of which the best and the worst are left out of a mean gain",
        "set by hand: an effect of time has no beginning without the first run",
    )
    unknown_share: float = _number(0.5, NOISE, "of the nodes of a declared table that states none", "set by hand")
    # -- what is left ----------------------------------------------------------------------------------------------------
    scan_fires_at: float = _number(
        2.2,
        "-log10 probability",
        "of the best wave left, among those of one column or of two with the signs of the rows drawn anew, or in one run",
        "1 in 160 by itself; of 500 machines without a cause 2.0 % said anything with it, of other 500 1.0 % with 2.5",
    )
    every_fires_at: float = _number(
        3.0,
        "-log10 probability",
        "of the best wave left along every so many rows",
        "reporting seeds 805480 to 805979, seen: of 14 causes"
        " on every tenth row none is below 3.8, of 500 machines without a cause none above 2.4",
    )
    by_signs: float = _number(
        0.02,
        SHARE,
        "of draws of the rows' signs that reach a smooth function's evidence, from which on it is put down to a few uneven rows",
        "of such a function 0.18, of 11 weak causes of other machines at most 0.01",
    )
    block_fires_at: float = _number(
        5.2,
        LOG,
        "of a smooth function left",
        "reporting seeds 805480 to 805979, seen: of 500 machines without a cause 3"
        " came beyond it, 2 beyond 6, 6 of 86 causes missed with 6",
    )
    process_fires_at: float = _number(
        6.2,
        LOG,
        "of a process in time left, alone or along the position",
        "the same: 1 of 500 beyond it, none beyond 8, 5 of 86 missed with 8",
    )
    directed_process_fires_at: float = _number(
        8.0,
        LOG,
        "of a process in time left that has the sign of the direction",
        "the same: 1 of 500 beyond it, 3 beyond 6.5, none of 86 missed with 8",
    )
    nearly_all: float = _number(
        0.98,
        SHARE,
        "of the variance beside the others from which an effect is not contested: what fits better mends its form",
        "a form that is off by a seventh",
    )
    beyond_repeats: float = _number(
        1.5,
        SHARE,
        "rows that vary so many times more than repeats do hold a cause",
        "noise that grows with speed may reach it",
    )
    unpredicted: float = _number(
        3.0,
        SHARE,
        "rows left out that vary so many times more than noise explains put every name in doubt",
        "tuning seeds: above it 10 of 16 confident names were right, below 94 of 101",
    )
    worse_left_out: float = _number(
        1.1,
        SHARE,
        "RMS of runs left out with what was found over that without, from which a name of position and direction alone is in doubt",
        "a tenth for what two fits of one table differ; two wrong zones without sensors have 1.4 and more",
    )
    sure: float = _number(0.9, RATE, "confidence of a name from which on it is sure", "said in the proof asked for")
    unsure_beyond: float = _number(
        2.4,
        SHARE,
        "rows left out that vary so many times more than noise explains are unexplained while a name is not sure, or there is none",
        "clean machines of the grammar come to 1.8, a measured stage whose warm-up three runs do not determine to 2.1; of 18 strong"
        " outside causes missed before, 5 are above",
    )
    opposed: float = _number(
        0.3,
        SHARE,
        "of each of two effects that their sum may be below, when one is there to undo the other",
        "500 machines without sensors: 4 pairs of findings are below 0.2, all of one cause",
    )
    most_times: float = _number(
        10.0,
        "folds",
        "standard deviation of an effect over that of all errors that cannot be, whatever undoes it",
        "a table may take out most of an expansion: at 15 K from the reference temperature some five times what is left",
    )
    whole_opposed_from: float = _number(
        2.0,
        "folds",
        "the same from which two effects that undo each other are not there, whatever a table can hold of them",
        "a measured resolver: of 24 draws 4 had effects of 34 to 240 times all errors, 2 of 7 (decision 0032)",
    )
    small_jump: float = _number(
        1.0,
        NOISE,
        "RMS over the rows of a jump below which its name is not sure: what switches on and off with a state or a place is often"
        " fitted best by one jump",
        "tuning seeds 105000 to 105499, outside weak: both sure ones below it were wrong, the one above right; 105000 to 105299, weak:"
        " of 13 sure ones, all right, 5 are below and lose their certainty",
    )
    simpler: float = _number(
        1.0,
        LOG,
        "that a pair of columns must have beyond one alone, and an effect beyond a slope of each run, to be sure; against a cause by a"
        " column that was not recorded",
        "2.7 to 1: less than that is not worth mentioning (Kass & Raftery)",
    )
    most_uneven: float = _number(
        4.0,
        SHARE,
        "size of a row's residual over the usual, beyond which it does not count as noise of its run, speed or place",
        "set by hand",
    )
    pseudo_rows: float = _number(
        10.0, "rows", "of average noise in each group before its scale is taken", "an earlier trial"
    )
    # -- noise -----------------------------------------------------------------------------------------------------------
    most_offset: float = _number(
        0.8, NOISE, "bound of the offsets of runs: a larger one is an effect", "an earlier trial"
    )
    slow_noise: float = _number(
        0.35,
        NOISE,
        "scale of the half-normal prior on them, and on memory that lasts longer than a few rows: more is drift, an effect",
        "an earlier trial",
    )
    short_memory: float = _number(1.2, NOISE, "scale of the prior on memory of a few rows", "set by hand")
    outlier_limit: float = _number(
        3.2,
        NOISE,
        "of a residual, robust; beyond it a row does not tell which rows lie far off",
        "1 row in 700 of normal noise",
    )
    outlier_tail: float = _number(
        1.5, "95 % quantiles", "the same; the larger counts, so that a real bulge is kept", "set by hand"
    )
    far_off: float = _number(
        6.0,
        NOISE,
        "beyond which a row lies far off: it counts no further for the noise and not for a name; a few such rows are a cause of their"
        " own, or part of an effect that is as large there",
        "1 row in 5e8 of normal noise, in 150 of Student's t with three degrees of freedom",
    )
    least_dof: float = _number(
        5.0, "degrees", "of freedom from which a floor is stated", "its std is then a third of it"
    )
    within_s: float = _number(30.0, "s", "between repeats in which nothing warms up", "set by hand")
    within_rows: float = _number(10.0, "rows", "the same where no time was recorded", "set by hand")
    # -- what is said ----------------------------------------------------------------------------------------------------
    least_confidence: float = _number(0.02, SHARE, "of a cause to be listed as a rival by the search", "set by hand")
    decided: float = _number(
        0.95,
        SHARE,
        "of a cause from which no further run is made",
        "an earlier trial: above it 316 of 316 were right",
    )
    sure_name: float = _number(
        0.5, SHARE, "from which a small effect is a finding", "likelier than all rivals together"
    )
    wander: float = _number(0.5, NOISE, "RMS of a drift that noise may reach", "set by hand")

    @classmethod
    def table(cls) -> dict[str, tuple[float, str, str, str]]:
        """By name: value, unit, meaning, origin."""
        return {f.name: (f.default, *(f.metadata[key] for key in ("unit", "meaning", "origin"))) for f in fields(cls)}


USUAL = Policy()
_IN_FORCE: ContextVar[Policy] = ContextVar("policy")


def policy() -> Policy:
    """The policy in force in this thread."""
    return _IN_FORCE.get(USUAL)


@contextmanager
def in_force(other: Policy) -> Iterator[None]:
    """Puts another policy into force, for a study of what its numbers do."""
    token = _IN_FORCE.set(other)
    try:
        yield
    finally:
        _IN_FORCE.reset(token)
