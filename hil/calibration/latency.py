"""Measuring the latency of the instrument's readings, by passes up and down at several feeds.

With a line that drive and instrument share, at its edges: this separates the link's latency from a lag of the table
behind its motor. Without it, on the fly: passes are made, dated by the latency known so far, and repeated until the
remaining shift is insignificant. `hil.figures.latency` says what this cannot separate.
"""

from __future__ import annotations

from dataclasses import replace

from drivers.errors import InputError
from hil.calibration.in_motion import FeedPass, check_passes, measure_in_motion, plan_passes
from hil.figures.latency import Latency, latency_at_edges, latency_by_passes, time_shift
from hil.machine.events import Listener, silent
from hil.machine.in_motion_settings import InMotion
from hil.machine.session import AxisSession
from hil.records.journal import Campaign

MOST_ROUNDS = 5
"""Most repetitions of the passes."""
ENOUGH_S = 2e-5
"""Resolution of the search, s: a smaller shift, or one within its uncertainty, ends it; a link known to this is
even.
"""
ROWS = 40
"""Rows per pass."""
EDGES_PERIOD_S = 0.01
"""Shortest period of set-points while latches are fetched between them: room for a few answers of the drive, s."""


def measure_latency(session: AxisSession, campaign: Campaign, how: InMotion, listener: Listener = silent) -> Latency:
    """Measures the latency on a prepared session, uncorrected. how: its latency is the starting value.

    Raises InputError for feeds that cannot separate latency from lost motion, or a latency that does not converge, and
    what `measure_in_motion` raises.
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
    """Settings whose samples are dated by the known latency, or by one measured now; by its own edge each, where the
    link is uneven.

    Returns the settings and the latency measured now, None where it was known. Raises as `measure_latency`.
    """
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


def _both_ways_first(passes: list[FeedPass]) -> list[FeedPass]:
    """Every second run begins downwards, so that drift is not taken for a difference of the directions."""
    pairs = [passes[place : place + 2] for place in range(0, len(passes), 2)]
    return [this for pair in pairs for this in (pair if pair[0].run % 2 else pair[::-1])]
