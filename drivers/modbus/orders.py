"""Orders to one Modbus unit that are waited for, and what stood in its settings before they were changed.

What may go in: writing and then seeing that it took effect. Which orders there are is the register map's business, what they mean
the drive's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.clock import Clock
from drivers.errors import MotionTimeoutError, NoAnswerError
from drivers.modbus.codec import Raw
from drivers.modbus.drive_map import Condition, Write, all_hold
from drivers.modbus.register_access import RegisterAccess, whole

POLL_S = 0.005
Evidence = Callable[[], bool]


class Orders:
    """shown_state(): the drive's present state in words, for what is said when something does not come."""

    def __init__(self, drive_name: str, access: RegisterAccess, clock: Clock, shown_state: Callable[[], str]) -> None:
        self._name = drive_name
        self._access = access
        self._clock = clock
        self._shown_state = shown_state
        self._found: dict[str, Raw] = {}  # settings as they were before we changed them

    # -- what stood there --------------------------------------------------------------------------------------------
    def forget(self) -> None:
        """A new connection: nothing has been changed yet."""
        self._found = {}

    def remember(self, names: Sequence[str]) -> None:
        """Note what stands there before it is written for the first time."""
        registers = self._access.registers
        new = [name for name in names if name not in self._found and registers[name].readable]
        if new:
            self._found.update(self._access.read(new))

    def put_back(self) -> None:
        """Everything that was remembered."""
        if self._found:
            self._access.write(self._found)
            self._found = {}

    # -- orders ------------------------------------------------------------------------------------------------------
    def give(self, writes: Sequence[Write]) -> None:
        """Each of them, certain when this returns."""
        for write in writes:
            self._access.command(write)

    def start(self, writes: Sequence[Write], what: str, timeout_s: float, taken: Evidence = lambda: False) -> None:
        """Start something. Where a start bit went unanswered and cannot be read back, what the axis does is the evidence."""
        for write in writes:
            try:
                self._access.command(write)
            except NoAnswerError as error:
                if not self.becomes(taken, timeout_s):
                    raise NoAnswerError(f"drive {self._name}: start of {what} is in doubt: {error}") from error

    def set_mode(
        self,
        writes: tuple[Write, ...],
        shown: tuple[Condition, ...],
        timeout_s: float,
        raw: dict[str, Raw] | None = None,
    ) -> None:
        """Change the mode of operation and see it confirmed; does nothing when it is already shown."""
        if not writes or (shown and self.hold_now(shown, raw or {})):
            return
        self.remember([write.register for write in writes if write.mask is None])
        self.give(writes)
        self.wait_for(shown, "change of mode", timeout_s)

    # -- waiting -----------------------------------------------------------------------------------------------------
    def hold_now(self, conditions: tuple[Condition, ...], raw: dict[str, Raw]) -> bool:
        """Whether they hold, from values just read where they are among them."""
        if all(condition.register in raw for condition in conditions):
            return hold(conditions, raw)
        return all_hold(conditions, self._access.of_conditions(conditions))

    def becomes(self, test: Evidence, timeout_s: float) -> bool:
        """Look until it is so; False when it does not come in time."""
        deadline = self._clock.deadline(timeout_s)
        while not test():
            if deadline.expired:
                return False
            self._clock.sleep_s(POLL_S)
        return True

    def wait_for(self, conditions: tuple[Condition, ...], what: str, timeout_s: float) -> None:
        """Raises MotionTimeoutError naming `what` when they do not come to hold."""
        if not conditions:
            return
        if not self.becomes(lambda: all_hold(conditions, self._access.of_conditions(conditions)), timeout_s):
            raise MotionTimeoutError(
                f"drive {self._name}: {what} not within {timeout_s:g} s, it is {self._shown_state()}"
            )


def hold(conditions: tuple[Condition, ...], raw: dict[str, Raw]) -> bool:
    """Whether all hold for these raw values."""
    return all_hold(
        conditions, {condition.register: whole(raw[condition.register], condition.register) for condition in conditions}
    )
