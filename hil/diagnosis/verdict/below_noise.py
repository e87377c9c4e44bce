"""Findings too small and too unsure to be told from noise that wanders.

A slow random walk looks like whatever changes slowly, and like no cause in particular: it makes something small that several effects
explain about equally well. What may go in: what counts as that, and what is said of it.
"""

from __future__ import annotations

from hil.diagnosis.result import Finding

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
