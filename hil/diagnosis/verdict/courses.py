"""A temperature that a course of the time since the start replaces: in one warm-up everything rises with the time.

What is found follows the temperature all the same, because that was measured. How sure that is decides what is said, and how far
the correction goes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.policy import policy
from hil.diagnosis.search.fit import Choice, JointFit, grid_choices
from hil.diagnosis.search.rank import score_choices
from hil.diagnosis.search.searcher import Searcher
from hil.effects import Columns, Term
from hil.effects.warming import (
    ALL_ROWS,
    Rows,
    as_far_as_seen,
    follows_a_temperature,
    is_about_a_point,
    is_since_start,
)


def courses_as_good(searcher: Searcher, noise: Noise, choices: Sequence[Choice]) -> dict[str, float]:
    """By effect that follows a measured temperature where a course of the time since the start fits as well: the log odds of all forms
    that were found of it against that course.
    """
    campaign = searcher.linear.campaign
    found: dict[str, float] = {}
    for effect in dict.fromkeys(choice.effect for choice in choices):
        mine = [choice for choice in choices if choice.effect is effect]
        known = [c for c in mine if c.form.inputs and c.form.inputs[0] in campaign.survey.temperatures]
        if not known:
            continue
        about = any(is_about_a_point(choice.form) for choice in known)
        courses = [
            course
            for form in effect.forms(campaign.survey)
            if is_since_start(form) and is_about_a_point(form) == about
            for course in grid_choices(effect, form)
        ]
        if not courses:
            continue
        projection = searcher.projection(noise, searcher.extra([c for c in choices if c.effect is not effect]))
        gains, _ = score_choices(projection, [*mine[:1], *courses])
        together = projection.gain(np.hstack([c.columns(campaign) for c in mine])) if len(mine) > 1 else float(gains[0])
        behind = together - sum(c.form.log_odds for c in mine) - float(np.max(gains[1:] - courses[0].form.log_odds))
        if behind < policy().as_well:
            found[effect.id] = behind
    return found


def course_note(effect: str, column: str, log_odds: float) -> str:
    """What is said of an effect that follows the temperature of a column, of `courses_as_good`."""
    bound = ", as far as it went on these rows" if _goes_no_further(log_odds) else ""
    return (
        f"{effect} follows {column}, and a course of the time since the start fits these rows as well (log odds {log_odds:.1f}): the"
        f" correction follows the temperature, which was measured{bound}; another warm-up tells the two apart"
    )


def bounded_note(term: Term) -> str:
    """What is said of a term of a declared model that is bounded so."""
    return (
        f"{term.effect.id} of the model given follows {term.needs[0]} as far as it went on any rows so far: a diagnosis of all of"
        " them, without that model, tells whether the temperature is its cause"
    )


def within_what_was_seen(
    fit: JointFit, courses: Mapping[str, float], columns: Columns, rows: Rows = ALL_ROWS, *, is_suspected: bool = False
) -> JointFit:
    """The fit, in which a temperature of `courses_as_good` counts no further than it went on some rows of these columns.

    Another warm-up may go far beyond; an offset that settles with the time would not. is_suspected: of an effect that noise may have
    made any temperature does
    """
    return fit.with_terms(
        [
            as_far_as_seen(term, columns, rows)
            if follows_a_temperature(term.form)
            and (is_suspected or _goes_no_further(courses.get(term.effect.id, np.inf)))
            else term
            for term in fit.found
        ]
    )


def _goes_no_further(log_odds: float) -> bool:
    return log_odds < policy().no_further
