"""Commands to one Modbus unit that are waited for, and the settings as they were before they were changed.

The register map defines the commands; `drive` decides when to give them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

from drivers.clock import Clock
from drivers.errors import AbortError, MotionTimeoutError, NoAnswerError, StateError
from drivers.modbus.codec import Raw
from drivers.modbus.drive_map import all_hold
from drivers.modbus.map_roles import Condition, Write
from drivers.modbus.register_access import RegisterAccess, whole
from drivers.modbus.wire import BUSY
from drivers.undo import undo_all
from drivers.way_out import WayOut

POLL_S = 0.005
_TARGETS_S = 3.0
"""Time of the shutdown that has to be left for putting targets back, s: half of what a drive has."""
Evidence = Callable[[], bool]


class Commands:
    """shown_state(): the drive's present state in words, for time-out errors. post_stop(): sends the stop.

    stopped: a stop was sent since the axis was enabled last, by any thread. From then on no order is sent, as one that enables
    makes the axis continue (CiA 402, transition 16).
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
        self._found: dict[str, Raw] = {}  # settings as they were before they were changed
        self._targets: dict[str, Raw] = {}  # likewise

    # -- earlier settings --------------------------------------------------------------------------------------------
    def forget(self) -> None:
        """For a new connection: nothing has been changed yet."""
        self._found, self._targets, self.stopped = {}, {}, False

    def remember(self, names: Sequence[str]) -> None:
        """Keep the values of these registers before they are written for the first time."""
        registers = self._access.registers
        new = [name for name in names if name not in self._found and registers[name].readable]
        if new:
            self._found.update(self._access.read(new))

    def keep(self, found: Mapping[str, Raw]) -> None:
        """Targets read before they were written; the first found stays, and is put back last."""
        self._targets = {**found, **self._targets}

    def kept(self, name: str) -> bool:
        """Whether the earlier value of this target is known."""
        return name in self._targets

    def put_back(self) -> None:
        """Restore everything that was remembered, each by a write of its own, targets last, whatever fails. Raises as `undo_all`."""
        found, self._found = self._found, {}
        steps = [(f"{name} not put back", partial(self._access.write, {name: found[name]})) for name in found]
        undo_all([*steps, ("target not put back", self._put_back_targets)])

    def _put_back_targets(self) -> None:
        """Targets act on nothing without power: of a drive so slow that shutting it down leaves no time, they stay as they are."""
        found, self._targets = self._targets, {}
        if found and self._way_out.within_s(_TARGETS_S) >= _TARGETS_S:
            self._access.write(found)

    # -- commands ----------------------------------------------------------------------------------------------------
    def give(self, writes: Sequence[Write]) -> None:
        """Write each of them; all are certain when this returns. Raises StateError once a stop was sent, and as `ModbusLink.write`."""
        for write in writes:
            self._unless_stopped(partial(self._access.command, write))
            self._pause(write)

    def give_stopped(self, writes: Sequence[Write]) -> None:
        """As `give`, also after a stop: for the writes that reset a fault."""
        for write in writes:
            self._access.command(write)
            self._pause(write)

    def take_power(self, writes: Sequence[Write]) -> None:
        """Writes that take power off, also after a stop; the only commands but the stop that are repeated while unanswered."""
        for write in writes:
            self._access.command(write, stops=True)
            self._pause(write)

    def _pause(self, write: Write) -> None:
        if write.pause_s:
            self._clock.sleep_s(self._way_out.within_s(write.pause_s))

    def write(self, values: Mapping[str, Raw]) -> None:
        """Write set-points, on which some drives start. Raises StateError once a stop was sent."""
        self._unless_stopped(partial(self._access.write, values))

    def _unless_stopped(self, order: Callable[[], None]) -> None:
        if not self.stopped:
            try:
                order()
            finally:
                if self.stopped:  # by another thread meanwhile: the order may have come after the stop
                    self._post_stop()
        if self.stopped:
            raise StateError(f"drive {self._name} was told to stop: enable it before the next command")

    def start(self, writes: Sequence[Write], what: str, timeout_s: float, taken: Evidence = lambda: False) -> None:
        """Start a motion. Where a start bit went unanswered and cannot be read back, `taken` decides. Raises NoAnswerError."""
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
        """Change the mode of operation and see it confirmed; nothing when it is already shown. Raises MotionTimeoutError."""
        if not writes or (shown and self.hold_now(shown, raw or {})):
            return
        self.remember([write.register for write in writes if write.mask is None])
        self.give(writes)
        self.wait_for(shown, "change of mode", timeout_s)

    # -- waiting -----------------------------------------------------------------------------------------------------
    def hold_now(self, conditions: tuple[Condition, ...], raw: dict[str, Raw]) -> bool:
        """Whether the conditions hold, with the values of `raw` where they are in it."""
        if all(condition.register in raw for condition in conditions):
            return hold(conditions, raw)
        return all_hold(conditions, self._access.of_conditions(conditions))

    def becomes(self, test: Evidence, timeout_s: float) -> bool:
        """Sample until it is true; False when it is not in time (s)."""
        return comes_true(test, self._way_out.within_s(timeout_s), self._clock)

    def wait_for(self, conditions: tuple[Condition, ...], what: str, timeout_s: float, remedy: str = "") -> None:
        """Wait until the conditions hold. Raises MotionTimeoutError naming `what`, and the remedy, after `timeout_s`."""
        if not conditions:
            return
        timeout_s = self._way_out.within_s(timeout_s)
        if not self.becomes(lambda: all_hold(conditions, self._access.of_conditions(conditions)), timeout_s):
            raise MotionTimeoutError(
                f"drive {self._name}: {what} not within {timeout_s:.3g} s, it is {self._shown_state()}{remedy and '; ' + remedy}"
            )


def comes_true(test: Evidence, timeout_s: float, clock: Clock) -> bool:
    """Sample until it is true; False when it is not in time (s). At least one sample, also where no time is left; a unit that is busy
    has not done it yet."""
    deadline = clock.deadline(timeout_s)
    while True:
        last = deadline.expired
        try:
            if test():
                return True
        except AbortError as error:
            if last or error.code != BUSY:
                raise
        if last:
            return False
        clock.sleep_s(POLL_S)


def hold(conditions: tuple[Condition, ...], raw: dict[str, Raw]) -> bool:
    """Whether all conditions hold for these raw values."""
    return all_hold(
        conditions, {condition.register: whole(raw[condition.register], condition.register) for condition in conditions}
    )
