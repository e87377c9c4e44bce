"""What a person says of an axis's zero for one job, and telling it to whoever holds the axis against its zero."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from drivers.errors import InputError
from hil.app.jobs.plan import Plan
from hil.machine.session import AxisSession


@dataclass(frozen=True)
class OfZero:
    """anew: take the zero anew, also where the axis stands now (homing 35, 37); what was made in the old one is of no use then.

    instrument_zeroed: the instrument was zeroed, or its beam was broken, since the axis was last measured.
    """

    anew: bool = False
    instrument_zeroed: bool = False

    def check(self, *, resume: bool) -> None:
        """Raises InputError for a zero that is to be new in a campaign of old rows."""
        if self.anew and resume:
            raise InputError("--new-zero does not go with --resume: the rows so far were measured in the old zero")

    def in_plan(self, plan: Plan) -> Plan:
        """The plan of a job that is told it."""
        return replace(plan, new_zero=self.anew, instrument_zeroed=self.instrument_zeroed)

    @contextmanager
    def told(self, session: AxisSession) -> Iterator[None]:
        """Inside, the session goes by it; afterwards by nothing of it, however the job ended: the session may outlast it."""
        keeper = session.zero
        if keeper is None:
            yield
            return
        keeper.anew, keeper.instrument_zeroed = self.anew, self.instrument_zeroed
        try:
            yield
        finally:
            keeper.anew = keeper.instrument_zeroed = False


UNSAID = OfZero()
