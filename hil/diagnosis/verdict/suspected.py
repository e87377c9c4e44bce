"""Suspected effects: more likely than not, and better on runs left out, but not proven, since noise may do as much.

A suspected effect is no finding. A correction has to choose, and the choice that predicts the left-out runs is the
better one; so the extended model holds it, and a note says so.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.diagnosis.result import Finding
from hil.diagnosis.search.choose import Chosen, Problem
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.verdict.held_out import ONCE, folds, gains_without, improves_held_out
from hil.effects import Action

SURE_NAME = 0.5
"""Confidence from which an effect is a finding however small: it is likelier than all its rivals together."""
WANDER = 0.5
"""RMS of a drift, over that of the noise, which noise may reach."""


def is_below_noise(finding: Finding, noise_um: float) -> bool:
    """Whether noise of this standard deviation may have drifted as much; an effect of position and direction alone is
    no drift.
    """
    effect = finding.term.effect
    return not effect.static and finding.confidence < SURE_NAME and finding.rms_um < WANDER * noise_um


def suspected_note(finding: Finding) -> str:
    """The note in place of a finding."""
    rivals = ", ".join(f"{rival.effect} {rival.confidence:.2f}" for rival in finding.rivals)
    return (
        f"{finding.effect} is suspected ({finding.rms_um:.2g} µm RMS, confidence {finding.confidence:.2f}"
        f"{'; ' + rivals if rivals else ''}): noise that wanders may make as much, so it is no finding and is not corrected; more runs"
        " would tell"
    )


LIKELY = 2.0
"""Log odds against none from which an effect is considered."""


def unproven_choice(problem: Problem, chosen: Chosen) -> Choice | None:
    """The best unproven effect of the machine itself, where nothing else was found and it predicts runs left out."""
    first, last = chosen.selections[0], chosen.last
    if chosen.fit.found or any(selected.hits for selected in chosen.selections) or not first.stages:
        return None
    stage = first.stages[-1]
    for ranked in stage.ranking:
        effect = ranked.choice.effect
        if ranked.evidence - stage.before < LIKELY:
            break
        if effect.action is not Action.COMPENSATE or effect.id in ONCE or ranked.choice.form.shrunk:
            continue
        fold, _ = folds(problem.campaign.run)
        trial = replace(last, choices=(ranked.choice,))
        gains = [gains_without(problem, trial, fold == i)[effect.id] for i in range(int(np.max(fold)) + 1)]
        return ranked.choice if improves_held_out(np.array(gains)) else None
    return None
