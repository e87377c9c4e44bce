"""An effect that is more likely than not and helps on runs left out, though noise may make as much of it.

It is no finding: a campaign of few runs cannot prove it. But a correction has to choose, and the choice that predicts the runs that
were left out is the better one; so the extended model holds it, and a note says so. What may go in: that choice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.diagnosis.result import Finding
from hil.diagnosis.search.choose import Chosen, Problem
from hil.diagnosis.search.fit import Choice
from hil.diagnosis.verdict.held_out import ONCE, earns_its_place, folds, gains_without
from hil.effects import Action

SURE_NAME = 0.5
"""Confidence from which a name stands for itself, however small the effect: it is likelier than all its rivals together."""
WANDER = 0.5
"""RMS over the noise's own up to which noise may wander."""


def is_faint(finding: Finding, noise_um: float) -> bool:
    """Whether noise of this standard deviation may have wandered so; what depends on place and direction alone does not wander."""
    effect = finding.term.effect
    return not effect.static and finding.confidence < SURE_NAME and finding.rms_um < WANDER * noise_um


def faint_note(finding: Finding) -> str:
    """What is said instead of a finding."""
    rivals = ", ".join(f"{rival.effect} {rival.confidence:.2f}" for rival in finding.rivals)
    return (
        f"{finding.effect} is suspected ({finding.rms_um:.2g} µm RMS, confidence {finding.confidence:.2f}"
        f"{'; ' + rivals if rivals else ''}): noise that wanders may make as much, so it is no finding and is not corrected; more runs"
        " would tell"
    )


LIKELY = 2.0
"""Log odds against nothing from which it is considered."""


def leaning(problem: Problem, chosen: Chosen) -> Choice | None:
    """The best effect of the machine itself that nothing proves, where nothing else was found and it predicts runs left out."""
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
        return ranked.choice if earns_its_place(np.array(gains)) else None
    return None
