"""One drive's part of a download, as steps: read, write in order, read back, or put everything back.

Nothing counts as written, or as put back, that was not read back from the drive afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

from drivers.clock import Clock
from drivers.errors import (
    AbortError,
    BridgeError,
    InputError,
    LinkLostError,
    ProtocolError,
    RemoteError,
    TransportError,
)
from drivers.raw_parameters import Access, Pause, RawParameters, Steps, Tell, no_observer

SETTLE_S = 0.5
"""Time limit for a drive to read back what it has accepted, s."""
RETRY_WITHIN_S = 3.0
"""Time for which putting back is retried while the drive does not answer, s."""
_POLL_S = 0.02
"""Interval between two readings back, and first interval between two retries, s."""


@dataclass
class Latencies:
    """Longest answer time of each address, s."""

    read_s: dict[str, float] = field(default_factory=dict)
    write_s: dict[str, float] = field(default_factory=dict)

    def note(self, kind: dict[str, float], accesses: Sequence[Access]) -> None:
        """Take the answer times of successful accesses. kind: `read_s` or `write_s`."""
        for each in accesses:
            if each.error is None:
                kind[each.address] = max(each.seconds, kind.get(each.address, 0.0))


@dataclass
class DriveJob:
    """Accesses to one drive. tell: called with the number of accesses done."""

    drive: RawParameters
    tell: Tell = no_observer
    settle_s: float = SETTLE_S
    latencies: Latencies = field(default_factory=Latencies)

    @property
    def clock(self) -> Clock:
        """The drive's clock."""
        return self.drive.clock

    # -- looking ---------------------------------------------------------------------------------------------------------
    def show(self, addresses: Sequence[str]) -> Steps[dict[str, bytes]]:
        """Read values, address -> the drive's bytes. Raises the error of the first failing access."""
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
        """Write the goals that differ from `present`, and read them back; returns the addresses written, in order.

        after: addresses to be written before an address; starts: the drive's count of restarts when `present` was read
        prove_all: read back all goals, not only those written
        Raises the drive's error, ProtocolError for a value that was accepted and does not read back, LinkLostError when the drive
        restarts meanwhile, InputError for a circular order.
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
        """Write in order. A refused value is tried again after the others, as it may depend on them. Raises the first refusal left."""
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
        """Read back until the values are the goals. Raises ProtocolError when they are not within `settle_s`."""
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
        self, goals: Mapping[str, bytes], after: Mapping[str, Sequence[str]], retry_within_s: float = RETRY_WITHIN_S
    ) -> Steps[list[str]]:
        """Bring the drive to the goals from any state, with retries until `retry_within_s` has passed; returns the addresses written.

        All goals are read back at the end. Raises the last error when it fails.
        """
        deadline = self.clock.deadline(retry_within_s)
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
    """An error's message as one line."""
    return " ".join(str(error).split())


# -- order of the writes -----------------------------------------------------------------------------------------------
def in_order(
    addresses: Sequence[str],
    rank: Callable[[str], int],
    after: Mapping[str, Sequence[str]],
    crossing: Sequence[tuple[str, str]] = (),
) -> list[str]:
    """The addresses in the order of writing: by rank, then as given, each behind those it depends on.

    after: address -> addresses to be written before it; crossing: further (first, second) pairs. Addresses outside of `addresses` are
    ignored. Raises InputError for a circular order.
    """
    known = set(addresses)
    before: dict[str, set[str]] = {address: set(after.get(address, ())) & known for address in addresses}
    for first, second in crossing:
        if first in known and second in known:
            before[second].add(first)
    place = {address: number for number, address in enumerate(sorted(addresses, key=rank))}
    sorter = TopologicalSorter(before)
    try:
        sorter.prepare()
    except CycleError as error:
        circle = " and ".join(sorted(set(error.args[1])))
        raise InputError(f"{circle} are to be written after each other, expected an order without a circle") from None
    free: list[str] = []
    ordered: list[str] = []
    while sorter.is_active():
        free = sorted([*free, *sorter.get_ready()], key=place.__getitem__)
        ordered.append(free.pop(0))
        sorter.done(ordered[-1])
    return ordered


def uncrossed(
    pairs: Sequence[tuple[str, str]], before: Mapping[str, float], wanted: Mapping[str, float]
) -> list[tuple[str, str]]:
    """Order of writing (first, second) of each pair of limits (low, high), so that low <= high holds at every moment.

    before, wanted: values by address, in the drive's unit. A pair that is not entirely in both is ignored.
    """
    found = []
    for low, high in pairs:
        if all(address in values for address in (low, high) for values in (before, wanted)):
            found.append((high, low) if wanted[low] > before[high] else (low, high))
    return found
