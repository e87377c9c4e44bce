"""A connected axis: its file, its session, and the bench in place of the machine where there is one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from drivers.clock import Clock
from drivers.drive import ServoDrive
from drivers.instrument import DistanceInstrument
from hil.axis.axis_file import AxisConfig
from hil.axis.zero import made_with_keeper, zero_keeper
from hil.machine.conditions import Conditions
from hil.machine.session import AxisSession

if TYPE_CHECKING:  # a verb on hardware loads no bench
    from sim_backends.bench import Bench


@dataclass(frozen=True)
class Machine:
    """A connected axis. bench: the simulated machine, None on hardware."""

    axis: AxisConfig
    session: AxisSession
    bench: Bench | None = None

    @property
    def clock(self) -> Clock:
        return self.session.clock


def session_of(
    axis: AxisConfig, drive: ServoDrive, instrument: DistanceInstrument, conditions: Conditions | None
) -> AxisSession:
    """A session with the settings of an axis file, not entered."""
    stale_after_s = axis.instrument.stale_after_s
    session = AxisSession(
        drive,
        instrument,
        axis.measurement,
        stale_after_s=stale_after_s,
        agreement=axis.agreement,
        conditions=conditions,
    )
    session.resume_within_s = axis.instrument.resume_within_s
    session.material = axis.instrument.material
    session.command_state.bound = axis.correction.bound
    session.made_with = made_with_keeper(axis)
    session.command_state.by_estimate = axis.lost_motion is not None and axis.lost_motion.travel_by == "estimate"
    session.zero = zero_keeper(axis)
    session.zero.guard(drive)
    return session
