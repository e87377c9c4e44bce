"""RawParameters: a drive's parameters as the bytes on its wire, for code that handles whole sets of them.

The one interface that a wire implements; `NamedParameters` accesses one parameter by name over it. It serves hundreds, on several
drives at a time: work on a drive is a generator that yields one transfer after another, so that the line serves other drives while
this drive prepares its answer. It reports what a parameter is, why it may not be written, its present bytes, and what an access costs;
which ones to write is the caller's decision.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

from drivers.clock import NS_PER_S, Clock
from drivers.drive import DriveState
from drivers.errors import AbortError, BridgeError, InputError, ProtocolError, TransportError
from drivers.parameters import ParameterInfo, ParameterKind, ParameterValue

T = TypeVar("T")
Steps = Generator[object, None, T]
"""Work on one drive. It yields `Pause`s, which every line carries out, or steps of its own kind of line; `Line.run` returns its
result."""

SETTLE_S = 0.5
"""Time limit for a drive to read back what it has accepted, s."""
_POLL_S = 0.02
"""Interval between two readings back, s."""

RawForm = int | str
"""A raw value as text for a person: a whole number where the type is one, else the bytes as hexadecimal digits."""


def _never() -> bool:
    return False


@dataclass(frozen=True)
class Pause:
    """A step of work that lets time pass while the line serves its other drives: at most `duration_s`, until `done()`."""

    duration_s: float
    done: Callable[[], bool] = _never


@dataclass(frozen=True)
class RawParameter:
    """One parameter. address: its place ("2210h:01", or a register's name); type: as the drive's own file names it.

    refusal: why it is never written as a parameter ("is read only", "moves the axis", …), None for one that the user may write; kind:
    what it is instead, in the plural of a list ("commands").
    """

    address: str
    info: ParameterInfo
    type: str
    refusal: str | None = None
    kind: str = "objects that are not written"

    @property
    def title(self) -> str:
        """Its address and name."""
        return self.address if self.info.name == self.address else f"{self.address} {self.info.name}"


@dataclass(frozen=True)
class Access:
    """One attempted access: the bytes read (None after a write), how long the answer took, or the error."""

    address: str
    seconds: float
    data: bytes | None = None
    error: BridgeError | None = None


Tell = Callable[[Sequence[Access]], None]
"""tell(accesses): these are done, successful or not."""


def no_observer(_accesses: Sequence[Access]) -> None:
    """No observer is registered; progress is dropped."""


@dataclass(frozen=True)
class DriveIdentity:
    """The identity that a drive reports. model: a set is never loaded into another model; version: of hardware and firmware, in which
    a set may lose its meaning; unit: this device."""

    protocol: str
    model: Mapping[str, int | str] = field(default_factory=dict)
    version: Mapping[str, int | str] = field(default_factory=dict)
    unit: Mapping[str, int | str] = field(default_factory=dict)


@dataclass(frozen=True)
class WireTime:
    """The cost of accesses: frames, seconds for which they keep the bus busy at most, answers among the frames."""

    frames: int = 0
    seconds: float = 0.0
    answers: int = 0

    def __add__(self, other: WireTime) -> WireTime:
        return WireTime(self.frames + other.frames, self.seconds + other.seconds, self.answers + other.answers)


class Line(ABC):
    """The bus or serial line of one or several drives."""

    @abstractmethod
    def run(self, jobs: Sequence[Steps[T]]) -> list[T | BridgeError]:
        """Run work on *different* drives side by side, as far as the wire allows; returns, in order, each result or its BridgeError.

        Any other exception ends all of it and is raised.
        """


class RawParameters(ABC):
    """The parameters of one drive that is not opened for motion. Nothing in it enables or moves.

    Its Steps raise AbortError, NoAnswerError, LinkLostError, ProtocolError; `read` and `write` put them into their Access instead.
    """

    name: str
    line: Line
    clock: Clock
    path: str | Path | None = None  # of the file that describes them
    assumed = False
    """Whether the drive may lack some of `entries`, as no file describes it."""

    # -- description; no I/O -------------------------------------------------------------------------------------------
    @property
    @abstractmethod
    def entries(self) -> Mapping[str, RawParameter]:
        """All parameters that can be read, by address, in the drive's order."""

    @property
    def names(self) -> Mapping[str, str]:
        """Name -> address of the parameters that can be read."""
        return {address: address for address in self.entries}

    def find(self, address: str) -> RawParameter | None:
        """The parameter at an address, None where the drive has none."""
        return self.entries.get(address)

    def unit_of(self, parameter: RawParameter) -> str:
        """The unit of a parameter's value; "" where it has none, or where none is known."""
        return parameter.info.unit

    def doubts_of_file(self, found: DriveIdentity) -> Sequence[str]:
        """Why the maker's file is not that of the drive found: another vendor, another product. Empty where there is no such file."""
        del found
        return ()

    @property
    def file_notes(self) -> Sequence[str]:
        """How the maker's file deviates from its standard, a line for each kind."""
        return ()

    @abstractmethod
    def encode(self, entry: RawParameter, value: ParameterValue) -> bytes:
        """A value in its unit -> bytes, rounded. Raises InputError for a value outside the type; `outside` checks the limits."""

    @abstractmethod
    def decode(self, entry: RawParameter, data: bytes) -> ParameterValue:
        """Bytes -> the value in its unit. Raises ProtocolError for a wrong length."""

    @abstractmethod
    def from_raw(self, entry: RawParameter, raw: RawForm) -> bytes:
        """A raw value -> bytes. Raises InputError for one that is not of the type."""

    @abstractmethod
    def to_raw(self, entry: RawParameter, data: bytes) -> RawForm:
        """Bytes -> the raw value."""

    def outside(self, entry: RawParameter, value: ParameterValue) -> str | None:
        """Why a value lies outside the limits; None where it lies within, or is what the drive's bytes hold for a limit."""
        if not isinstance(value, int | float):
            return None
        why = replace(entry.info, unit=self.unit_of(entry)).outside(value)
        return None if why is None or self._is_limit(entry, value) else why

    def _is_limit(self, entry: RawParameter, value: float) -> bool:
        limits = (entry.info.low, entry.info.high) if entry.info.kind is ParameterKind.NUMBER else ()
        for limit in limits:
            with suppress(InputError):  # a limit outside the type
                if limit is not None and value == self.decode(entry, self.encode(entry, limit)):
                    return True
        return False

    def objection(self, entry: RawParameter, data: bytes) -> str | None:
        """Why these bytes may not be written there (no parameter, limits, wear), None when they may."""
        return entry.refusal or self.outside(entry, self.decode(entry, data))

    def same(self, entry: RawParameter, shown: bytes, meant: bytes) -> bool:
        """Whether the bytes shown by the drive equal the bytes meant."""
        del entry
        return shown == meant

    def rank(self, address: str) -> int:
        """Order of writing: the lower rank first (units before values that are given in them)."""
        del address
        return 0

    @property
    def limit_pairs(self) -> Sequence[tuple[str, str]]:
        """Addresses (lowest, highest) of pairs of limits; drives refuse a write that makes the lowest exceed the highest."""
        return ()

    @abstractmethod
    def cost(self, reads: Sequence[tuple[str, bytes]], writes: Sequence[tuple[str, bytes]]) -> WireTime:
        """The cost on a free bus of reading these (with the bytes that they will probably show) and writing those.

        The drive's own processing time is not included: it is added for each of `answers`.
        """

    # -- on the wire -----------------------------------------------------------------------------------------------------
    @abstractmethod
    def identify(self) -> Steps[DriveIdentity]:
        """The identity that the drive reports."""

    @abstractmethod
    def state(self) -> Steps[DriveState]:
        """Its present state (CiA-402 terms)."""

    def read(self, addresses: Sequence[str], tell: Tell = no_observer) -> Steps[list[Access]]:
        """Read; one Access each, in order. After one without any answer the rest is not tried and carries the same error."""
        found: dict[str, Access] = {}
        for group in self._read_groups(addresses):
            accesses = yield from self._try_reading(group)
            if len(group) > 1 and isinstance(accesses[0].error, AbortError):  # find the one that is refused
                accesses = []
                for address in group:
                    accesses += yield from self._try_reading([address])
                    if isinstance(accesses[-1].error, TransportError):
                        break
            found |= {each.address: each for each in accesses}
            tell(accesses)
            silence = accesses[-1]
            if isinstance(silence.error, TransportError):
                left = [address for address in addresses if address not in found]
                found |= {address: replace(silence, address=address) for address in left}
                break
        return [found[address] for address in addresses]

    def write(self, items: Sequence[tuple[str, bytes]], tell: Tell = no_observer) -> Steps[list[Access]]:
        """Write in order, up to the first that fails; returns the attempted accesses. Nothing is read back here."""
        accesses: list[Access] = []
        for group in self._write_groups(items):
            tried = yield from self._try_writing(group)
            if len(group) > 1 and isinstance(tried[-1].error, AbortError):  # find the one that is refused
                tried = []
                for item in group:
                    tried += yield from self._try_writing([item])
                    if tried[-1].error is not None:
                        break
            accesses += tried
            tell([each for each in tried if each.error is None])
            if accesses[-1].error is not None:
                break
        return accesses

    def _try_reading(self, group: Sequence[str]) -> Steps[list[Access]]:
        start_ns = self.clock.now_ns()
        try:
            values = yield from self._read_group(group)
        except (AbortError, ProtocolError, TransportError) as error:
            return [Access(address, self._since_s(start_ns), error=error) for address in group]
        seconds = self._since_s(start_ns)
        return [Access(address, seconds, data) for address, data in zip(group, values, strict=True)]

    def _try_writing(self, items: Sequence[tuple[str, bytes]]) -> Steps[list[Access]]:
        start_ns = self.clock.now_ns()
        try:
            yield from self._write_group(items)
        except BridgeError as error:
            return [Access(items[0][0], self._since_s(start_ns), error=error)]
        seconds = self._since_s(start_ns)
        return [Access(address, seconds) for address, _ in items]

    def _since_s(self, start_ns: int) -> float:
        return (self.clock.now_ns() - start_ns) / NS_PER_S

    def _read_groups(self, addresses: Sequence[str]) -> Iterable[Sequence[str]]:
        """The addresses, those together that one access reads."""
        return [[address] for address in addresses]

    @abstractmethod
    def _read_group(self, addresses: Sequence[str]) -> Steps[Sequence[bytes]]:
        """Read a group."""

    def _write_groups(self, items: Sequence[tuple[str, bytes]]) -> Iterable[Sequence[tuple[str, bytes]]]:
        """The items in order, those together that one access writes."""
        return [[item] for item in items]

    @abstractmethod
    def _write_group(self, items: Sequence[tuple[str, bytes]]) -> Steps[None]:
        """Write a group."""

    def show(self, addresses: Sequence[str], tell: Tell = no_observer) -> Steps[dict[str, bytes]]:
        """Read; address -> bytes. Raises the error of the first failing access."""
        accesses = yield from self.read(addresses, tell)
        for each in accesses:
            if each.error is not None:
                raise each.error
        return {each.address: each.data for each in accesses if each.data is not None}

    def prove(self, goals: Mapping[str, bytes], tell: Tell = no_observer, settle_s: float = SETTLE_S) -> Steps[None]:
        """Read back until the values are the goals. Raises ProtocolError when they are not within `settle_s`."""
        deadline = self.clock.deadline(settle_s)
        wrong = list(goals)
        while True:
            shown = yield from self.show(wrong, tell)
            wrong = [address for address in wrong if not self.shows(address, shown[address], goals[address])]
            if not wrong:
                return
            if deadline.expired:
                raise ProtocolError(self._mismatch(wrong[0], goals[wrong[0]], shown[wrong[0]], len(wrong)))
            yield Pause(_POLL_S)

    def shows(self, address: str, shown: bytes, meant: bytes) -> bool:
        """As `same`, for an address that the drive's file may not have."""
        parameter = self.find(address)
        return shown == meant if parameter is None else self.same(parameter, shown, meant)

    def _mismatch(self, address: str, meant: bytes, shown: bytes, count: int) -> str:
        parameter = self.find(address)
        if parameter is None:
            return f"drive {self.name}: {address} reads back {shown.hex()}, written was {meant.hex()}"
        values = [self.decode(parameter, data) for data in (meant, shown)]
        more = "" if count == 1 else f" (and {count - 1} more)"
        return f"drive {self.name}: {parameter.title} was written {values[0]!r}, it reads back {values[1]!r}{more}"

    @abstractmethod
    def objection_to_store(self) -> Steps[str | None]:
        """Why the drive cannot store its parameters on command, None when it can."""

    @abstractmethod
    def store(self) -> Steps[None]:
        """Have the drive store its parameters; its targets are made harmless before. Raises CapabilityError, StateError."""

    @abstractmethod
    def load_defaults(self) -> Steps[None]:
        """Restore factory defaults, in force after its next start. Raises CapabilityError."""

    @abstractmethod
    def restart(self) -> Steps[None]:
        """Restart it as a power cycle would. Raises CapabilityError where only switching its supply can."""

    @property
    def restarts(self) -> int:
        """Number of its starts that were received; always 0 where the drive does not announce them."""
        return 0

    @property
    def hears_restarts(self) -> bool:
        """Whether a start of the drive would be noticed."""
        return False

    @property
    def gone(self) -> bool:
        """Whether this program's end of the line is known to be lost, so that retrying is useless."""
        return False
