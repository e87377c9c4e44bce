"""A person's statement about an axis's zero for one job: to be taken anew, or the instrument was zeroed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from drivers.errors import InputError
from hil.desk.plan import Plan
from hil.machine.session import AxisSession


@dataclass(frozen=True)
class ZeroStatement:
    """The statement.

    anew: take the zero anew, also where the axis stands now (homing 35, 37); tables and rows of the old zero are then invalid
    instrument_zeroed: the instrument was zeroed, or its beam was broken, since the axis was last measured
    """

    anew: bool = False
    instrument_zeroed: bool = False

    def check(self, *, resume: bool) -> None:
        """Raises InputError for a new zero in a resumed campaign."""
        if self.anew and resume:
            raise InputError("a resumed job takes no new zero: its rows so far were measured in the old one")

    def in_plan(self, plan: Plan) -> Plan:
        return replace(plan, new_zero=self.anew, instrument_zeroed=self.instrument_zeroed)

    @contextmanager
    def applied(self, session: AxisSession) -> Iterator[None]:
        """Apply the statement to the session's zero inside the block, and withdraw it at the end, as the session may outlast the
        job."""
        keeper = session.zero
        if keeper is None:
            yield
            return
        keeper.anew, keeper.instrument_zeroed = self.anew, self.instrument_zeroed
        try:
            yield
        finally:
            keeper.anew = keeper.instrument_zeroed = False


NO_STATEMENT = ZeroStatement()
