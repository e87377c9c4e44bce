"""Measuring how late the instrument's readings are, by passes up and down at several feeds.

With a line that drive and instrument share, at its edges: this tells the link's latency from a lag of the table behind its motor.
Without it, on the fly: passes are made, dated by what is known of the latency, and made again until nothing more is found. What that
cannot tell apart stands in `hil.figures.latency`.
"""

from __future__ import annotations

from dataclasses import replace

from drivers.errors import InputError
from hil.calibration.in_motion import InMotion, Pass, check_passes, measure_in_motion, plan_passes
from hil.figures.latency import Latency, latency_at_edges, latency_by_passes, time_shift
from hil.machine.events import Listener, silent
from hil.machine.session import AxisSession
from hil.records.journal import Campaign

MOST_ROUNDS = 5
ENOUGH_S = 2e-5
"""A shift below this, or within its uncertainty, is no reason for another round; a link that is known so well is even."""
ROWS = 40
EDGES_PERIOD_S = 0.01
"""Set-points come no faster while latches are fetched between them: a few answers of the drive have room in it."""


def measure_latency(session: AxisSession, campaign: Campaign, how: InMotion, listener: Listener = silent) -> Latency:
    """On a prepared session; nothing is corrected meanwhile. how: its latency is where the search begins.

    Raises InputError for feeds that cannot tell a latency from lost motion, or a latency that is not found, and what
    `measure_in_motion` raises.
    """
    how = replace(how, rows=ROWS)
    if how.trigger_input is not None:
        how = replace(how, period_s=max(how.period_s, EDGES_PERIOD_S))
    check_passes(session, how)
    compensation, session.compensation = session.compensation, None
    try:
        if how.trigger_input is not None:
            passes = _both_ways_first(plan_passes(session, how, 0))
            return latency_at_edges(measure_in_motion(session, campaign, "latency", passes, how=how, listener=listener))
        return _by_passes(session, campaign, how, listener)
    finally:
        session.compensation = compensation


def dated(
    session: AxisSession, campaign: Campaign, how: InMotion, listener: Listener = silent
) -> tuple[InMotion, Latency | None]:
    """Passes whose samples are dated by a latency, the one that is known, or else measured now, as `measure_latency`; or each by its
    own edge, where edges showed that the link is uneven."""
    if how.latency_s is not None:
        return replace(how, trigger_input=None), None
    latency = measure_latency(session, campaign, how, listener)
    how = replace(how, latency_s=latency.latency_s, dated_by=latency.describe())
    if latency.at_edges and latency.within_s > ENOUGH_S:
        by = f"the edge of each row; the link is uneven, {latency.describe()}"
        return replace(how, dated_by=by, period_s=max(how.period_s, EDGES_PERIOD_S)), latency
    return replace(how, trigger_input=None), latency


def _by_passes(session: AxisSession, campaign: Campaign, how: InMotion, listener: Listener) -> Latency:
    latency_s = how.latency_s or 0.0
    for number in range(1, MOST_ROUNDS + 1):
        passes = _both_ways_first(plan_passes(session, how, number))
        dated = replace(how, latency_s=latency_s)
        shift = time_shift(
            measure_in_motion(session, campaign, f"latency-{number}", passes, how=dated, listener=listener)
        )
        if abs(shift.shift_s) <= max(ENOUGH_S, shift.within_s):
            return latency_by_passes(latency_s, shift)
        latency_s += shift.shift_s
    raise InputError(
        f"instrument {session.instrument.name}: after {MOST_ROUNDS} rounds of passes its latency still changes by"
        f" {1e3 * shift.shift_s:.3f} ms; expected samples that come evenly, or are asked for"
    )


def _both_ways_first(passes: list[Pass]) -> list[Pass]:
    """Every second run begins downwards: what drifts in between is not taken for a difference of the two ways."""
    pairs = [passes[place : place + 2] for place in range(0, len(passes), 2)]
    return [this for pair in pairs for this in (pair if pair[0].run % 2 else pair[::-1])]
