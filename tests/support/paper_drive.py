"""A drive without a wire or physics: its parameters in a dictionary, with every access, start and refusal set by the test."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from drivers.drive import DriveState
from drivers.errors import BridgeError
from drivers.parameters import ParameterInfo, ParameterKind, ParameterValue
from drivers.raw_parameters import (
    SETTLE_S,
    DriveIdentity,
    Line,
    Pause,
    RawForm,
    RawParameter,
    RawParameters,
    Steps,
    T,
    WireTime,
)
from hil.parameters.journal import Journal
from hil.parameters.set_file import ParameterSet
from hil.parameters.transaction import DriveTask, Target
from sim_backends.clock import SimClock

IDENTITY = DriveIdentity("canopen", {"vendor_id": 0x1A}, {"firmware": "2"}, {"serial": 7})


class OneByOne(Line):
    """A line that carries out one job after the other. A pause takes its time, any other step none."""

    def __init__(self, clock: SimClock) -> None:
        self._clock = clock

    def run(self, jobs: Sequence[Steps[T]]) -> list[T | BridgeError]:
        return [self._one(job) for job in jobs]

    def _one(self, job: Steps[T]) -> T | BridgeError:
        try:
            while True:
                step = next(job)
                if isinstance(step, Pause) and not step.done():
                    self._clock.sleep_s(step.duration_s)
        except StopIteration as stop:
            result: T = stop.value
            return result
        except BridgeError as error:
            return error


def done(job: Steps[T], clock: SimClock) -> T:
    """The result of a job; its error is raised. clock: of the drive, for its pauses."""
    result = OneByOne(clock).run([job])[0]
    if isinstance(result, BridgeError):
        raise result
    return result


def task_on(drive: RawParameters, settle_s: float = SETTLE_S) -> DriveTask:
    """A task of this drive with nothing to write and no journal."""
    return DriveTask(Target(drive, ParameterSet("nothing", None, ()), Journal(Path("nowhere"))), settle_s)


class PaperDrive(RawParameters):
    """Two-byte whole numbers by name. An access takes a millisecond.

    on_read, on_write: called with the address (and the bytes) before the access; what they raise is its error, and a write that
    returns False is not accepted. log: every access, "r a", "w a 5", "store", "restart".
    """

    def __init__(self, name: str = "X", clock: SimClock | None = None, **values: int) -> None:
        self.name, self.clock = name, clock or SimClock()
        self.line = OneByOne(self.clock)
        self.held = {address: value.to_bytes(2, "little") for address, value in values.items()}
        self.refusals: dict[str, str] = {}
        self.log: list[str] = []
        self.starts, self.hears, self.lost = 0, True, False
        self.shown_state, self.identity = DriveState.SWITCH_ON_DISABLED, IDENTITY
        self.on_read: Callable[[str], None] = lambda _address: None
        self.on_write: Callable[[str, int], bool | None] = lambda _address, _value: None
        self.on_store: Callable[[], None] = lambda: None
        self.on_state: Callable[[], None] = lambda: None
        self.on_restart: Callable[[], None] = lambda: None
        self.no_store: str | None = None
        self.ranks: dict[str, int] = {}
        self.pairs: tuple[tuple[str, str], ...] = ()

    def number(self, address: str) -> int:
        return int.from_bytes(self.held[address], "little")

    def bytes_of(self, **values: int) -> dict[str, bytes]:
        return {address: value.to_bytes(2, "little") for address, value in values.items()}

    @property
    def entries(self) -> Mapping[str, RawParameter]:
        return {
            address: RawParameter(
                address,
                ParameterInfo(f"name of {address}", ParameterKind.INTEGER, "rpm"),
                "U16",
                self.refusals.get(address),
            )
            for address in self.held
        }

    def encode(self, entry: RawParameter, value: ParameterValue) -> bytes:
        return int(value).to_bytes(2, "little")

    def decode(self, entry: RawParameter, data: bytes) -> ParameterValue:
        return int.from_bytes(data, "little")

    def from_raw(self, entry: RawParameter, raw: RawForm) -> bytes:
        return int(raw).to_bytes(2, "little")

    def to_raw(self, entry: RawParameter, data: bytes) -> RawForm:
        return int.from_bytes(data, "little")

    def rank(self, address: str) -> int:
        return self.ranks.get(address, 0)

    @property
    def limit_pairs(self) -> Sequence[tuple[str, str]]:
        return self.pairs

    def cost(self, reads: Sequence[tuple[str, bytes]], writes: Sequence[tuple[str, bytes]]) -> WireTime:
        """A frame of 100 to 120 bits and 0.1 to 0.12 ms for each read, two of them for each write."""
        n = len(reads) + 2 * len(writes)
        return WireTime(n, 1.2e-4 * n, len(reads) + len(writes))

    def identify(self) -> Steps[DriveIdentity]:
        yield None
        return self.identity

    def state(self) -> Steps[DriveState]:
        yield None
        self.on_state()
        return self.shown_state

    def _read_group(self, addresses: Sequence[str]) -> Steps[Sequence[bytes]]:
        (address,) = addresses
        yield None
        self.log.append(f"r {address}")
        self.clock.sleep_s(0.001)
        self.on_read(address)
        return [self.held[address]]

    def _write_group(self, items: Sequence[tuple[str, bytes]]) -> Steps[None]:
        ((address, data),) = items
        yield None
        value = int.from_bytes(data, "little")
        self.log.append(f"w {address} {value}")
        self.clock.sleep_s(0.001)
        if self.on_write(address, value) is not False:
            self.held[address] = data

    def objection_to_store(self) -> Steps[str | None]:
        yield None
        return self.no_store

    def store(self) -> Steps[None]:
        yield None
        self.log.append("store")
        self.on_store()

    def load_defaults(self) -> Steps[None]:
        yield None
        self.log.append("defaults")

    def restart(self) -> Steps[None]:
        yield None
        self.log.append("restart")
        self.on_restart()

    @property
    def restarts(self) -> int:
        return self.starts

    @property
    def hears_restarts(self) -> bool:
        return self.hears

    @property
    def gone(self) -> bool:
        return self.lost
