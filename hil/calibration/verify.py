"""Verification: measure with the correction in force at targets other than those it was computed from, and compare with
the band.
"""

from __future__ import annotations

from dataclasses import dataclass

from hil.correction.tables import Band, NotJudged, Outside, judge, section_means
from hil.machine.events import Listener, silent
from hil.machine.measure import bidirectional_steps, measure, other_targets
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import Records


@dataclass(frozen=True)
class Verification:
    """The result of a verification; `outside` is empty without a band. not_judged: where none is asked for."""

    records: Records
    outside: tuple[Outside, ...]
    not_judged: tuple[NotJudged, ...] = ()

    @property
    def good(self) -> bool:
        """No judged section is outside the band."""
        return not self.outside


def verify(
    session: AxisSession,
    campaign: Campaign,
    name: str = "verify",
    band: Band | None = None,
    listener: Listener = silent,
    *,
    seed: int = 1,
) -> Verification:
    """Measures on a prepared session with the compensation in force.

    seed: determines the other targets. Raises InputError for rows of another plan, and what stops the axis.
    """
    steps = bidirectional_steps(other_targets(session.how, seed), session.how.runs)
    records = measure(session, campaign, name, steps, listener)
    if band is None:
        return Verification(records, ())
    return Verification(records, *judge(section_means(records), band, session.how.targets_mm))
