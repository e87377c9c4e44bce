"""Orders to one Modbus unit that are waited for, and what stood in its settings before they were changed.

Which orders there are is the register map's business, what they mean the drive's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from drivers.clock import Clock
from drivers.errors import MotionTimeoutError, NoAnswerError, StateError
from drivers.modbus.codec import Raw
from drivers.modbus.drive_map import all_hold
from drivers.modbus.map_roles import Condition, Write
from drivers.modbus.register_access import RegisterAccess, whole
from drivers.modbus.way_out import WayOut
from drivers.undo import undo_all

POLL_S = 0.005
Evidence = Callable[[], bool]


class Orders:
    """shown_state(): the drive's present state in words, for what is said when something does not come. post_stop(): sends the stop.

    stopped: a stop was sent since the axis was enabled last, by any thread. From then on no order leaves here, as one that enables
    would let the axis go on (CiA 402, transition 16).
    """

    def __init__(
        self,
        drive_name: str,
        access: RegisterAccess,
        clock: Clock,
        *,
        way_out: WayOut,
        shown_state: Callable[[], str],
        post_stop: Callable[[], None],
    ) -> None:
        self._name = drive_name
        self._access = access
        self._clock = clock
        self._way_out = way_out
        self._shown_state = shown_state
        self._post_stop = post_stop
        self.stopped = False
        self._found: dict[str, Raw] = {}  # settings as they were before we changed them

    # -- what stood there --------------------------------------------------------------------------------------------
    def forget(self) -> None:
        """A new connection: nothing has been changed yet."""
        self._found, self.stopped = {}, False

    def remember(self, names: Sequence[str]) -> None:
        """Note what stands there before it is written for the first time."""
        registers = self._access.registers
        new = [name for name in names if name not in self._found and registers[name].readable]
        if new:
            self._found.update(self._access.read(new))

    def put_back(self) -> None:
        """Everything that was remembered, each by a write of its own: what cannot be put back keeps nothing else from it."""
        found, self._found = self._found, {}
        undo_all([(f"{name} not put back", partial(self._access.write, {name: found[name]})) for name in found])

    # -- orders ------------------------------------------------------------------------------------------------------
    def give(self, writes: Sequence[Write]) -> None:
        """Each of them, certain when this returns. Raises StateError once the axis was told to stop."""
        for write in writes:
            self._unless_stopped(partial(self._access.command, write))

    def give_stopped(self, writes: Sequence[Write]) -> None:
        """The same for what resets a fault, which a stopped axis does too."""
        for write in writes:
            self._access.command(write)

    def take_power(self, writes: Sequence[Write]) -> None:
        """What takes power off, from a stopped axis too; the only orders but the stop that are sent again while unanswered."""
        for write in writes:
            self._access.command(write, stops=True)

    def write(self, values: Mapping[str, Raw]) -> None:
        """Set-points, on which some drives start. Raises StateError once the axis was told to stop."""
        self._unless_stopped(partial(self._access.write, values))

    def _unless_stopped(self, order: Callable[[], None]) -> None:
        if not self.stopped:
            try:
                order()
            finally:
                if self.stopped:  # meanwhile, by another thread: the order may have come after the stop
                    self._post_stop()
        if self.stopped:
            raise StateError(f"drive {self._name} was told to stop; it takes orders again once it is enabled anew")

    def start(self, writes: Sequence[Write], what: str, timeout_s: float, taken: Evidence = lambda: False) -> None:
        """Start something. Where a start bit went unanswered and cannot be read back, what the axis does is the evidence."""
        for write in writes:
            try:
                self.give((write,))
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
        """Look until it is so; False when it does not come in time. At least one look, also where no time is left for the way out."""
        deadline = self._clock.deadline(self._way_out.within_s(timeout_s))
        while not test():
            if deadline.expired:
                return False
            self._clock.sleep_s(POLL_S)
        return True

    def wait_for(self, conditions: tuple[Condition, ...], what: str, timeout_s: float) -> None:
        """Raises MotionTimeoutError naming `what` when they do not come to hold."""
        if not conditions:
            return
        timeout_s = self._way_out.within_s(timeout_s)
        if not self.becomes(lambda: all_hold(conditions, self._access.of_conditions(conditions)), timeout_s):
            raise MotionTimeoutError(
                f"drive {self._name}: {what} not within {timeout_s:.3g} s, it is {self._shown_state()}"
            )


def hold(conditions: tuple[Condition, ...], raw: dict[str, Raw]) -> bool:
    """Whether all hold for these raw values."""
    return all_hold(
        conditions, {condition.register: whole(raw[condition.register], condition.register) for condition in conditions}
    )
