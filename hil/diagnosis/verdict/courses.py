"""A temperature that a course of the time since the start replaces: in one warm-up everything rises with the time.

What is found follows the temperature all the same, because that was measured. How sure that is decides what is said, and how far
the correction goes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Noise, Projection
from hil.diagnosis.policy import policy
from hil.diagnosis.search.fit import Choice, JointFit, grid_choices
from hil.diagnosis.search.rank import refine, score_choices
from hil.diagnosis.search.searcher import Searcher
from hil.effects import Columns, Effect, Term
from hil.effects.warming import (
    ALL_ROWS,
    Rows,
    as_far_as_seen,
    follows_a_temperature,
    from_a_start,
    is_about_a_point,
    is_since_start,
    time_unit,
)

BY_TEMPERATURE = {"thermal_expansion": "ppm/K", "thermal_drift": "µm/K"}
"""Effects that follow a temperature of the machine, and the unit of their first coefficient."""
MOST_AWAY_K = 10.0
"""A hall that was not heated over night is as much colder; what needs more is something else that warms up."""


def courses_as_good(searcher: Searcher, noise: Noise, choices: Sequence[Choice]) -> dict[str, float]:
    """By effect that follows a measured temperature where a course of the time since the start fits as well: the log odds of all forms
    that were found of it against that course.
    """
    campaign = searcher.linear.campaign
    found: dict[str, float] = {}
    for effect in dict.fromkeys(choice.effect for choice in choices):
        mine = [choice for choice in choices if choice.effect is effect]
        known = [c for c in mine if c.form.inputs and c.form.inputs[0] in campaign.survey.warmth]
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
        together = _gain_of(mine, projection, campaign) if len(mine) > 1 else float(gains[0])
        behind = together - sum(c.form.log_odds for c in mine) - float(np.max(gains[1:] - courses[0].form.log_odds))
        if behind < policy().very_strong:
            found[effect.id] = behind
    return found


def steadier(
    searcher: Searcher, noise: Noise, choices: Sequence[Choice], read: Columns
) -> tuple[tuple[Choice, ...], list[str]]:
    """The choices without forms of one effect that undo each other, where they cost a correction more than they gain; notes of it.

    Two forms that follow a thermometer are together as sharp as the rows say: 64 and -54 ppm/K through a lag of 8 s are a screw that
    leads its thermometer. A correction has each reading as it comes, with the noise that a fit takes out of whole records, and so a
    difference of large coefficients of it. Where that is more than one form alone leaves, in the mean square, this is taken.

    read: the columns with the temperatures as they were read, (n,) each
    """
    columns, notes, kept = searcher.linear.campaign.columns, list[str](), tuple(choices)
    for effect in dict.fromkeys(choice.effect for choice in choices):
        mine = [choice for choice in kept if choice.effect is effect]
        if effect.several or len(mine) == 1 or not all(follows_a_temperature(choice.form) for choice in mine):
            continue
        if len({choice.form.inputs[0] for choice in mine}) > 1:
            continue
        others = [choice for choice in kept if choice.effect is not effect]
        alone = max(refine(searcher.projection(noise, searcher.extra(others)), mine), key=lambda pair: pair[1])[0]
        both, single = (searcher.fit(some, noise, uncertain=False) for some in (kept, [*others, alone]))
        lost_um = float(np.std(both.whole.error_um(columns) - single.whole.error_um(columns)))
        added_um = _as_it_comes_um(both, effect, columns, read)
        if added_um**2 - _as_it_comes_um(single, effect, columns, read) ** 2 > lost_um**2:
            kept = tuple(alone if choice is mine[0] else choice for choice in kept if choice not in mine[1:])
            notes.append(
                f"{effect.id} follows {alone.form.inputs[0]} by one form: two that undo each other would follow its changes more"
                f" sharply, which gains {lost_um:.2g} µm on these rows and adds {added_um:.2g} µm of the thermometer's noise; a"
                " quicker thermometer, or one nearer to what grows, would gain it"
            )
    return kept, notes


def _as_it_comes_um(fit: JointFit, effect: Effect, columns: Columns, read: Columns) -> float:
    """Standard deviation, µm, of what the noise of thermometers adds to a correction for an effect."""
    mine = [term for term in fit.found if term.effect is effect]
    return float(np.std(np.sum([term.error_um(read) - term.error_um(columns) for term in mine], axis=0)))


def _gain_of(choices: Sequence[Choice], projection: Projection, campaign: CampaignRows) -> float:
    """Gain of some choices together, with the log prior odds of their forms and parameters."""
    known = sum(choice.log_prior for choice in choices)
    return projection.gain(np.hstack([choice.columns(campaign) for choice in choices])) + known


def start_as_good(searcher: Searcher, noise: Noise, choices: Sequence[Choice]) -> str:
    """What is said of a body that starts away from what its sensor says, where that alone fits these rows as well as all that was
    found of temperatures and of the time since the start; else empty.
    """
    campaign = searcher.linear.campaign
    survey = campaign.survey
    mine = [choice for choice in choices if choice.effect.id in BY_TEMPERATURE]
    if not mine:
        return ""
    others = [choice for choice in choices if choice not in mine]
    trials = [
        choice
        for effect in dict.fromkeys(choice.effect for choice in mine)
        for form in from_a_start(effect.forms(survey), survey)
        for choice in grid_choices(effect, form)
    ]
    if not trials:
        return ""
    projection = searcher.projection(noise, searcher.extra(others))
    gains, _ = score_choices(projection, trials)
    best = refine(projection, [trials[int(np.argmax(gains))]])[0][0]
    ahead = searcher.profiled_evidence([*others, best], noise)[0] - searcher.profiled_evidence(choices, noise)[0]
    if ahead < 0.0:
        return ""
    term = searcher.fit([*others, best], noise).found[-1]
    growth, away_k = term.coefficient(0), term.coefficients[1] / term.coefficients[0]
    if abs(growth.value) <= 2.0 * growth.std or abs(away_k) > MOST_AWAY_K or term.effect.implausible(term):
        return ""
    return (
        f"{term.effect.id} by {term.needs[0]} through a lag of {term.nonlinear(0)} {time_unit(term)}, {growth}"
        f" {BY_TEMPERATURE[term.effect.id]}, from a start {away_k:.2g} K away from what that said, fits these rows as well as what was"
        f" found (log odds {ahead:.1f}): where the machine had not settled when they began, let it settle and measure again"
    )


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
