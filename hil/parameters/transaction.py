"""One drive's part of a download, as steps: read, write in order, read back, or put everything back.

Nothing counts as written, or as put back, that was not read back from the drive afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter

from drivers.errors import AbortError, BridgeError, InputError, LinkLostError, RemoteError, TransportError
from drivers.raw_parameters import (
    SETTLE_S,
    Access,
    DriveIdentity,
    Pause,
    RawParameter,
    RawParameters,
    Steps,
    Tell,
    no_observer,
)
from hil.correction.store import BoundTables
from hil.parameters.journal import Download, DownloadPhase, Journal
from hil.parameters.preflight import Objection
from hil.parameters.report import Ending
from hil.parameters.set_file import ParameterSet

RETRY_WITHIN_S = 3.0
"""Time for which putting back is retried while the drive does not answer, s."""
_POLL_S = 0.02
"""First interval between two retries, s."""


@dataclass
class Target:
    """One drive of a download: its set and its journal. any_version: a set of another revision or firmware is allowed.

    other_eds: a maker's file of another vendor or product is allowed;
    tables: what the axis's stored tables were made with, None where it has none; backlash: addresses of the drive's own compensation
    """

    drive: RawParameters
    contents: ParameterSet
    journal: Journal
    any_version: bool = False
    other_eds: bool = False
    tables: BoundTables | None = None
    backlash: Sequence[str] = ()


@dataclass
class DriveTask:
    """A target during a job. old, new: address -> the drive's bytes, as far as known; after: address -> addresses written before it.

    tell: called with the accesses done; read_s, write_s: longest answer time of each address
    """

    target: Target
    settle_s: float = SETTLE_S
    tell: Tell = no_observer
    read_s: dict[str, float] = field(default_factory=dict)
    write_s: dict[str, float] = field(default_factory=dict)
    identity: DriveIdentity | None = None
    parameters: dict[str, RawParameter] = field(default_factory=dict)
    old: dict[str, bytes] = field(default_factory=dict)
    new: dict[str, bytes] = field(default_factory=dict)
    after: dict[str, Sequence[str]] = field(default_factory=dict)
    objections: list[Objection] = field(default_factory=list)
    noted: Download | None = None
    ending: Ending | None = None
    stored: bool = False
    error: str = ""
    not_kept: str = ""  # the drive's reason for not storing
    notes: list[str] = field(default_factory=list)
    meant_back: bool = False
    audited: bool | None = None
    lost: list[str] = field(default_factory=list)
    began_ns: int = 0
    starts: int = 0  # the drive's count of restarts when its values were read
    seconds: float = 0.0

    @property
    def drive(self) -> RawParameters:
        return self.target.drive

    @property
    def journal(self) -> Journal:
        return self.target.journal

    def done(self, accesses: Sequence[Access]) -> None:
        """Take the answer times of successful accesses, and pass them on to `tell`."""
        for each in accesses:
            if each.error is None:
                kind = self.write_s if each.data is None else self.read_s
                kind[each.address] = max(each.seconds, kind.get(each.address, 0.0))
        self.tell(accesses)

    def fail(self, error: BridgeError) -> None:
        """Set the error, unless there is one already."""
        self.error = self.error or ended_in(error)

    def differing(self) -> list[str]:
        """Addresses whose new value is not the old one."""
        return [address for address in self.new if not self.drive.shows(address, self.old[address], self.new[address])]

    def note(self, phase: DownloadPhase, **facts: object) -> None:
        """Append a step to the journal, where this drive has one. Raises InputError when it cannot be written."""
        if self.noted is not None:
            self.journal.note(self.noted, phase, **facts)

    # -- bringing the drive to what is wanted ----------------------------------------------------------------------------
    def bring(
        self, goals: Mapping[str, bytes], present: Mapping[str, bytes], *, starts: int, prove_all: bool = False
    ) -> Steps[list[str]]:
        """Write the goals that differ from `present`, and read them back; returns the addresses written, in order.

        starts: the drive's count of restarts when `present` was read
        prove_all: read back all goals, not only those written
        Raises the drive's error, ProtocolError for a value that was accepted and does not read back, LinkLostError when the drive
        restarts meanwhile, InputError for a circular order.
        """
        drive = self.drive
        differing = [address for address in goals if not drive.shows(address, present[address], goals[address])]
        ordered = self._ordered(differing, present, goals)
        yield from self._write(ordered, goals)
        prove_all = prove_all or (bool(ordered) and not drive.hears_restarts)
        proven = goals if prove_all else {address: goals[address] for address in ordered}
        yield from drive.prove(proven, self.done, self.settle_s)
        if drive.restarts != starts:
            raise LinkLostError(f"drive {drive.name} restarted meanwhile")
        return ordered

    def _ordered(self, differing: Sequence[str], present: Mapping[str, bytes], goals: Mapping[str, bytes]) -> list[str]:
        pairs = self.drive.limit_pairs
        crossing = uncrossed(pairs, self._numbers(pairs, present), self._numbers(pairs, goals))
        return in_order(differing, self.drive.rank, self.after, crossing)

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
            accesses = yield from self.drive.write([(address, goals[address]) for address in pending], self.done)
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

    # -- going to one side, whatever it takes ----------------------------------------------------------------------------
    def settle_at(self, goals: Mapping[str, bytes], retry_within_s: float = RETRY_WITHIN_S) -> Steps[list[str]]:
        """Bring the drive to the goals from any state, with retries until `retry_within_s` has passed; returns the addresses written.

        All goals are read back at the end. Raises the last error when it fails.
        """
        deadline = self.drive.clock.deadline(retry_within_s)
        pause_s = _POLL_S
        written: list[str] = []
        while True:
            try:
                starts = self.drive.restarts
                present = yield from self.drive.show(list(goals), self.done)
                written += yield from self.bring(goals, present, starts=starts, prove_all=True)
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
        raise InputError(
            f"{circle} each have to be written after the other, expected an order without a cycle"
        ) from None
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
