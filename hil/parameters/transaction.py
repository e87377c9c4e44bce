"""One drive's part of a download, as steps: look, write, prove, or put everything back.

What may go in: what is done in which order, against `RawParameters`; no wire, and no decision about other drives (`several`).
The rule behind every line: nothing counts as written, or as put back, that the drive has not shown since.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from drivers.clock import Clock
from drivers.errors import (
    AbortError,
    BridgeError,
    LinkLostError,
    ProtocolError,
    RemoteError,
    TransportError,
)
from drivers.raw_parameters import Access, Pause, RawParameters, Steps, Tell, no_observer
from hil.parameters.order import in_order, uncrossed

SETTLE_S = 0.5  # a drive may take this long to show what it has taken
PATIENCE_S = 3.0  # how long putting back is tried while nobody answers
_POLL_S = 0.02


@dataclass
class Latencies:
    """Of each address, the longest that an answer took, s."""

    read_s: dict[str, float] = field(default_factory=dict)
    write_s: dict[str, float] = field(default_factory=dict)

    def note(self, kind: dict[str, float], accesses: Sequence[Access]) -> None:
        for each in accesses:
            if each.error is None:
                kind[each.address] = max(each.seconds, kind.get(each.address, 0.0))


@dataclass
class DriveJob:
    """Work on one drive. tell: of each access that is through."""

    drive: RawParameters
    tell: Tell = no_observer
    settle_s: float = SETTLE_S
    latencies: Latencies = field(default_factory=Latencies)

    @property
    def clock(self) -> Clock:
        return self.drive.clock

    # -- looking ---------------------------------------------------------------------------------------------------------
    def show(self, addresses: Sequence[str]) -> Steps[dict[str, bytes]]:
        """What the drive holds. Raises what the first failing access gave, a refused one with its address."""
        accesses = yield from self.drive.read(addresses, self.tell)
        self.latencies.note(self.latencies.read_s, accesses)
        for each in accesses:
            if each.error is not None:
                raise each.error
        return {each.address: each.data for each in accesses if each.data is not None}

    # -- bringing the drive to what is wanted ----------------------------------------------------------------------------
    def bring(
        self,
        goals: Mapping[str, bytes],
        present: Mapping[str, bytes],
        after: Mapping[str, Sequence[str]],
        *,
        starts: int,
        prove_all: bool = False,
    ) -> Steps[list[str]]:
        """Write those goals that are not present, and prove them by reading back; the addresses written.

        starts: how often the drive had been heard to start when `present` was read; prove_all: read back also what was not written.
        Raises what the drive gave, ProtocolError for what it took and does not show, LinkLostError when it started anew meanwhile.
        """
        drive = self.drive
        differing = [address for address in goals if not self._same(address, present[address], goals[address])]
        ordered = self._ordered(differing, present, goals, after)
        yield from self._write(ordered, goals)
        prove_all = prove_all or (bool(ordered) and not drive.hears_restarts)
        yield from self.prove(list(goals) if prove_all else ordered, goals)
        if drive.restarts != starts:
            raise LinkLostError(f"drive {drive.name} started anew meanwhile")
        return ordered

    def _ordered(
        self,
        differing: Sequence[str],
        present: Mapping[str, bytes],
        goals: Mapping[str, bytes],
        after: Mapping[str, Sequence[str]],
    ) -> list[str]:
        pairs = self.drive.limit_pairs
        crossing = uncrossed(pairs, self._numbers(pairs, present), self._numbers(pairs, goals))
        return in_order(differing, self.drive.rank, after, crossing)

    def _numbers(self, pairs: Sequence[tuple[str, str]], data: Mapping[str, bytes]) -> dict[str, float]:
        numbers: dict[str, float] = {}
        for address in (address for pair in pairs for address in pair if address in data):
            parameter = self.drive.find(address)
            value = None if parameter is None else self.drive.decode(parameter, data[address])
            if isinstance(value, int | float):
                numbers[address] = value
        return numbers

    def _write(self, ordered: Sequence[str], goals: Mapping[str, bytes]) -> Steps[None]:
        """What the drive refuses is tried again once others have been written: it may have depended on them."""
        pending = list(ordered)
        refused: list[tuple[str, AbortError]] = []
        progress = False
        while pending:
            accesses = yield from self.drive.write([(address, goals[address]) for address in pending], self.tell)
            self.latencies.note(self.latencies.write_s, accesses)
            error = accesses[-1].error
            done = len(accesses) - (error is not None)
            progress |= done > 0
            if error is None:
                pending = []
            elif isinstance(error, AbortError):
                refused.append((pending[done], error))
                pending = pending[done + 1 :]
            else:
                raise error
            if refused and progress and not pending:
                pending, refused, progress = [address for address, _ in refused], [], False
        if refused:
            raise refused[0][1]

    def prove(self, addresses: Sequence[str], goals: Mapping[str, bytes]) -> Steps[None]:
        """Read them back until they are the goals. Raises ProtocolError when they are not within `settle_s`."""
        deadline = self.clock.deadline(self.settle_s)
        wrong = list(addresses)
        while True:
            shown = yield from self.show(wrong)
            wrong = [address for address in wrong if not self._same(address, shown[address], goals[address])]
            if not wrong:
                return
            if deadline.expired:
                raise ProtocolError(self._mismatch(wrong[0], goals[wrong[0]], shown[wrong[0]], len(wrong)))
            yield Pause(_POLL_S)

    def _mismatch(self, address: str, meant: bytes, shown: bytes, count: int) -> str:
        parameter = self.drive.find(address)
        if parameter is None:
            return f"drive {self.drive.name}: {address} reads back {shown.hex()}, written was {meant.hex()}"
        values = [self.drive.decode(parameter, data) for data in (meant, shown)]
        more = "" if count == 1 else f" (and {count - 1} more)"
        return (
            f"drive {self.drive.name}: {address} {parameter.info.name} was written {values[0]!r},"
            f" it reads back {values[1]!r}{more}"
        )

    def _same(self, address: str, shown: bytes, meant: bytes) -> bool:
        parameter = self.drive.find(address)
        return shown == meant if parameter is None else self.drive.same(parameter, shown, meant)

    # -- going to one side, whatever it takes ----------------------------------------------------------------------------
    def settle_at(
        self, goals: Mapping[str, bytes], after: Mapping[str, Sequence[str]], patience_s: float = PATIENCE_S
    ) -> Steps[list[str]]:
        """Bring the drive to the goals from wherever it is, trying again until `patience_s` has passed; the addresses written.

        Everything is read back at the end. Raises the last error when it cannot be done.
        """
        deadline = self.clock.deadline(patience_s)
        pause_s = _POLL_S
        written: list[str] = []
        while True:
            try:
                starts = self.drive.restarts
                present = yield from self.show(list(goals))
                written += yield from self.bring(goals, present, after, starts=starts, prove_all=True)
            except LinkLostError as error:
                if self.drive.gone or deadline.expired:
                    raise error
            except (TransportError, RemoteError):
                if deadline.expired:
                    raise
            else:
                return written
            yield Pause(pause_s)
            pause_s *= 2


def ended_in(error: BridgeError) -> str:
    """An error as a report's one line."""
    return " ".join(str(error).split())
