"""RawParameters: a drive's parameters as the bytes that stand on its wire, for whoever handles whole sets of them.

`DriveParameters` is the face for one parameter by name. This one is for hundreds, on several drives at a time: work on a drive is a
generator that hands its line one transfer after another, so that the line can serve other drives while this one thinks. Nothing here
decides what is to be written; it says what a parameter is, why it may not be written, what the drive shows, and what that costs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from drivers.clock import Clock
from drivers.drive import DriveState
from drivers.errors import BridgeError
from drivers.parameters import ParameterInfo, ParameterValue

T = TypeVar("T")
Steps = Generator[object, None, T]
"""Work on one drive. It yields `Pause`s, which every line knows, or what its own line carries out; `Line.run` returns its result."""

Tell = Callable[[int], None]
"""tell(n): n more accesses are through."""

RawForm = int | str
"""A raw value as a person reads it: a whole number where the type is one, else the bytes as hexadecimal digits."""


def _never() -> bool:
    return False


@dataclass(frozen=True)
class Pause:
    """A step of work that lets time pass, while the line serves its other drives: `duration_s` at most, less once `done()`."""

    duration_s: float
    done: Callable[[], bool] = _never


def deaf(_count: int) -> None:
    """Nobody wants to be told."""


@dataclass(frozen=True)
class RawParameter:
    """One parameter. address: where it stands ("2210h:01", or a register's name); type: as the drive's own file names it.

    refusal: why it is never written as a parameter (read only, moves the axis, …), None for one that is the user's.
    """

    address: str
    info: ParameterInfo
    type: str
    refusal: str | None = None


@dataclass(frozen=True)
class Access:
    """One access that was tried: what the drive showed (None after a write), how long its answer took, or why there is none."""

    address: str
    seconds: float
    data: bytes | None = None
    error: BridgeError | None = None


@dataclass(frozen=True)
class DriveIdentity:
    """Who a drive says it is. model: a set for one never goes into another; version: what a set may not survive; unit: this one."""

    protocol: str
    model: Mapping[str, int | str] = field(default_factory=dict)
    version: Mapping[str, int | str] = field(default_factory=dict)
    unit: Mapping[str, int | str] = field(default_factory=dict)


@dataclass(frozen=True)
class WireTime:
    """What accesses cost. frames and bits on the bus (Modbus: characters as bits), seconds the bus is busy, answers the drive gives.

    least and most: without stuffing and with the worst; likely: with the values that are known beforehand.
    """

    frames: int = 0
    bits_least: int = 0
    bits_likely: int = 0
    bits_most: int = 0
    seconds_least: float = 0.0
    seconds_likely: float = 0.0
    seconds_most: float = 0.0
    answers: int = 0

    def __add__(self, other: WireTime) -> WireTime:
        return WireTime(
            *(
                getattr(self, name) + getattr(other, name)
                for name in (
                    "frames",
                    "bits_least",
                    "bits_likely",
                    "bits_most",
                    "seconds_least",
                    "seconds_likely",
                    "seconds_most",
                    "answers",
                )
            )
        )


class Line(ABC):
    """What one or several drives hang on."""

    @abstractmethod
    def run(self, jobs: Sequence[Steps[T]]) -> list[T | BridgeError]:
        """Run work on *different* drives side by side, as far as the wire allows; in its place, the result of each or its BridgeError.

        Other exceptions end all of it and are raised.
        """


class RawParameters(ABC):
    """The parameters of one drive that is not opened for motion. Nothing in it enables or moves.

    Its Steps raise AbortError, NoAnswerError, LinkLostError, ProtocolError; `read` and `write` put them into their Access instead.
    """

    name: str
    line: Line
    clock: Clock

    # -- what there is; no I/O -----------------------------------------------------------------------------------------
    @property
    @abstractmethod
    def entries(self) -> Mapping[str, RawParameter]:
        """All that can be read, by address, in the drive's order."""

    def find(self, address: str) -> RawParameter | None:
        """The parameter at an address, None for one that the drive does not have."""
        return self.entries.get(address)

    @abstractmethod
    def encode(self, entry: RawParameter, value: ParameterValue) -> bytes:
        """A value in its unit -> bytes. Raises InputError for what does not fit the type; limits are `objection`'s."""

    @abstractmethod
    def decode(self, entry: RawParameter, data: bytes) -> ParameterValue:
        """Bytes -> the value in its unit. Raises ProtocolError for a wrong length."""

    @abstractmethod
    def from_raw(self, entry: RawParameter, raw: RawForm) -> bytes:
        """A raw value -> bytes. Raises InputError."""

    @abstractmethod
    def to_raw(self, entry: RawParameter, data: bytes) -> RawForm:
        """Bytes -> the raw value."""

    @abstractmethod
    def objection(self, entry: RawParameter, data: bytes) -> str | None:
        """Why these bytes may not be written there (no parameter, type, limits, wear), None when they may."""

    def same(self, entry: RawParameter, shown: bytes, meant: bytes) -> bool:
        """Whether what the drive shows is what was meant."""
        del entry
        return shown == meant

    def rank(self, address: str) -> int:
        """What has to be written first has the lower rank (units before values in them)."""
        del address
        return 0

    @property
    def limit_pairs(self) -> Sequence[tuple[str, str]]:
        """Addresses (lowest, highest) of limits that drives refuse to have crossed."""
        return ()

    @abstractmethod
    def cost(self, reads: Sequence[tuple[str, bytes]], writes: Sequence[tuple[str, bytes]]) -> WireTime:
        """What reading these (with what they will show, as far as one can guess) and writing those costs on a free bus.

        The drive's own time is not in it: it comes on top for each of `answers`.
        """

    # -- on the wire -----------------------------------------------------------------------------------------------------
    @abstractmethod
    def identify(self) -> Steps[DriveIdentity]:
        """Who it is."""

    @abstractmethod
    def state(self) -> Steps[DriveState]:
        """Its present state."""

    @abstractmethod
    def read(self, addresses: Sequence[str], tell: Tell = deaf) -> Steps[list[Access]]:
        """Read; one Access each, in order. What is not answered at all ends the rest, which then carries the same error."""

    @abstractmethod
    def write(self, items: Sequence[tuple[str, bytes]], tell: Tell = deaf) -> Steps[list[Access]]:
        """Write in order, up to the first that fails: the accesses that were tried. Nothing is read back here."""

    @abstractmethod
    def objection_to_store(self) -> Steps[str | None]:
        """Why it cannot be told to keep its parameters, None when it can."""

    @abstractmethod
    def store(self) -> Steps[None]:
        """Have it keep its parameters, targets being made harmless before. Raises CapabilityError, StateError."""

    @abstractmethod
    def load_defaults(self) -> Steps[None]:
        """Factory defaults, in force after its next start. Raises CapabilityError."""

    @abstractmethod
    def restart(self) -> Steps[None]:
        """Start it anew as a power cycle would. Raises CapabilityError where only its supply can."""

    @property
    def restarts(self) -> int:
        """How often it was heard to start; 0 for good where it says nothing of it."""
        return 0

    @property
    def hears_restarts(self) -> bool:
        """Whether a start of the drive would be heard."""
        return False

    @property
    def gone(self) -> bool:
        """Whether our own end of the line is known to be lost, so that trying again makes no sense."""
        return False
