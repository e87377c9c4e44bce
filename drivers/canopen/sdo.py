"""SDO client of one node: guarded against late answers, lost writes and a server that stops in the middle of a transfer.

`SdoClient` serves one node over a `CanLink`; `side_by_side` keeps the channels of several nodes busy at once.
An answer counts only when it names the index that was requested. After a time-out the channel must be silent before it is used
again. A write whose answer was lost is resolved by reading back all of it, never by sending it a second time.
Every transfer has two deadlines that other traffic on the channel does not extend: `timeout_s` from the last answer that continued it,
and `longest_s`, by the bytes carried, from its beginning. While a drive is shut down all transfers share a third one: `WayOut`.
"""

from __future__ import annotations

import contextlib
import math
import operator
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from drivers.canopen.abort_codes import ABORT_GENERAL, ABORT_TIMEOUT
from drivers.canopen.bus import STOP_SEND_S, CanLink
from drivers.canopen.sdo_transfer import (
    LARGEST_ANNOUNCED,
    Conversation,
    Transfer,
    abort_frame,
    block_download,
    block_upload,
    download,
    longest_s,
    upload,
)
from drivers.cia402.objects import Entry
from drivers.cia402.wire import OBJECT_MISSING, Absent
from drivers.clock import NS_PER_S
from drivers.errors import (
    AbortError,
    BridgeError,
    LinkLostError,
    NoAnswerError,
    OtherAnswerError,
    ProtocolError,
    RemoteError,
    StateError,
    TransportError,
)
from drivers.raw_parameters import Pause, Steps
from drivers.way_out import WayOut

T = TypeVar("T")
LONGEST_TEXT = 4096
"""Longest VISIBLE_STRING that is read, bytes; the standard's texts have a few dozen."""
Same = Callable[[bytes, bytes], bool]
"""same(shown, meant): whether bytes that were read back equal the value that was written."""
FIRST_AXIS = range(0x6000, 0x6800)
AXIS_OFFSET = 0x800
WRONG_LENGTH = (0x06070010, 0x06070012, 0x06070013)
SDO_REQUEST = 0x600
SDO_RESPONSE = 0x580
QUIET_TIMES = 10  # number of quiet times after which a channel that does not fall silent is given up


def most_bytes(entry: Entry) -> int:
    """Longest answer accepted, bytes: for a number eight, the longest type's, as some devices answer with more than the object has."""
    return 8 if entry.type.is_number else LONGEST_TEXT if entry.type.is_text else LARGEST_ANNOUNCED


@dataclass
class SdoCounters:
    """Events on one channel since it was opened."""

    transfers: int = 0
    timeouts: int = 0
    writes_confirmed_late: int = 0  # by an answer that came after the time-out
    writes_read_back: int = 0  # by comparing the object after a time-out


class Awaited(Protocol):
    """Something awaited on a link: it is finished by a frame, or expires at `until_ns`."""

    @property
    def finished(self) -> bool: ...

    @property
    def until_ns(self) -> int: ...

    def expire(self) -> None:
        """Its time is over: become finished."""


class Running(Generic[T]):
    """One transfer in progress on one channel. timeout_s: longest silence, s; None: the client's."""

    def __init__(
        self, client: SdoClient, talk: Conversation, transfer: Transfer[T], timeout_s: float | None = None
    ) -> None:
        self.client = client
        self.talk = talk
        self.timeout_s = timeout_s or client.timeout_s
        self._transfer = transfer
        self.began_ns = self._moved_ns = self._steps = 0
        self._limit_ns: float = math.inf  # of a drive that is shut down
        self.finished = False
        self.result: T | None = None
        self.error: BridgeError | None = None

    def start(self) -> None:
        self.began_ns = self._moved_ns = self.client.link.clock.now_ns()
        self._limit_ns = self.began_ns + self.client.reply_s() * NS_PER_S
        self._step(None)

    def on_frame(self, time_ns: int, data: bytes) -> None:
        if self.finished:
            return
        self._step(data)
        if self.talk.steps != self._steps:
            self._steps, self._moved_ns = self.talk.steps, time_ns

    @property
    def until_ns(self) -> int:
        """End of its time, ns: no answer continued it in time, or it takes too long for the bytes carried."""
        longest_ns = round(longest_s(self.timeout_s, self.talk.carried) * NS_PER_S)
        own_ns = min(self._moved_ns + round(self.timeout_s * NS_PER_S), self.began_ns + longest_ns)
        return own_ns if self._limit_ns == math.inf else min(own_ns, round(self._limit_ns))

    def expire(self) -> None:
        self.client.end()

    def _step(self, data: bytes | None) -> None:
        try:
            frames = next(self._transfer) if data is None else self._transfer.send(data)
        except StopIteration as stop:
            self.result = stop.value
            self._finish()
        except (AbortError, ProtocolError) as error:
            self.error = self.client.named(error)
            self._finish()
        else:
            for frame in frames:
                self.client.transmit(frame)

    def _finish(self) -> None:
        try:
            for frame in self.talk.closing_frames:
                self.client.transmit(frame)
        finally:
            self.finished = True  # last: another thread may wait for it, and then begin the next transfer

    def fail(self, error: BridgeError) -> None:
        """End the transfer with this error."""
        self.error, self.finished = error, True

    def abandon(self) -> None:
        """Time is up: send an abort to the server, and end the transfer with NoAnswerError."""
        self._transfer.close()
        kind, how = (
            (OtherAnswerError, self.talk.instead) if self.talk.instead else (NoAnswerError, "was not answered in time")
        )
        if self.talk.steps:
            lasted_s = (self.client.link.clock.now_ns() - self.began_ns) / NS_PER_S
            how += f": {self.talk.carried} bytes in {lasted_s:.3f} s"
        self.fail(kind(f"{self.client.name}: SDO {self.talk.place()} {how}"))
        with contextlib.suppress(LinkLostError):  # the waiting call has already raised for a lost bus
            self.client.transmit(abort_frame(self.talk.index, self.talk.subindex, ABORT_TIMEOUT))

    def outcome(self) -> T | None:
        """The result. Raises the transfer's error."""
        if self.error is not None:
            raise self.error
        return self.result


class SdoClient:
    """The default SDO channel of one node (CiA-301, 7.2.4).

    timeout_s: longest time for one answer, s; a transfer of n bytes ends within `longest_s(timeout_s, n)`. quiet_s: silence of the
    channel, s, before it is used again after a time-out; an answer within that time is late, not lost. axis: of a node with several;
    an `Entry` of the device profile then means that axis's (CiA 402: index + 800h for each further axis); `read_bytes` and
    `write_bytes` take indices as they are. way_out: limits the requests while the drive is shut down.
    """

    def __init__(
        self,
        link: CanLink,
        node_id: int,
        name: str,
        *,
        timeout_s: float = 0.5,
        quiet_s: float = 0.2,
        axis: int = 1,
        way_out: WayOut | None = None,
    ) -> None:
        self.link = link
        self._offset = AXIS_OFFSET * (axis - 1)
        self.node_id = node_id
        self.name = name
        self.timeout_s = timeout_s
        self.quiet_s = quiet_s
        self.counters = SdoCounters()
        self.way_out = way_out
        self._silent = False  # the last request was not answered
        self._running: Running[Any] | None = None
        self._stepping = threading.RLock()  # one thread begins and ends a transfer, another may dispatch its answers
        self._abandoned: Conversation | None = None  # until the channel has been quiet after it
        self._late_ns: list[int] = []  # times of frames that may belong to it
        self._late: Callable[[bytes], None] | None = None
        link.subscribe(SDO_RESPONSE + node_id, self._on_frame)

    def close(self) -> None:
        self.link.unsubscribe(SDO_RESPONSE + self.node_id, self._on_frame)

    def named(self, error: BridgeError) -> BridgeError:
        """The same error with the device's name in front."""
        if isinstance(error, AbortError):
            return AbortError(f"{self.name}: {error}", error.code)
        return type(error)(f"{self.name}: {error}")

    def transmit(self, frame: bytes) -> None:
        """Send a frame of this channel. Raises LinkLostError."""
        self.link.send(SDO_REQUEST + self.node_id, frame)

    def send_at_once(self, entry: Entry, value: int) -> None:
        """Write a number of up to four bytes without waiting for the answer. For a stop: from any thread, and from a signal handler.

        A transfer in progress on this channel is aborted first, as a server in the middle of one may take the frame for a part of it;
        the call that waits for that transfer gets a StateError. Raises LinkLostError.
        """
        running = self._running
        if running is not None and not running.finished:
            running.error = StateError(f"{self.name}: SDO {running.talk.place()} was broken off by a stop")
            running.finished = True
            abort = abort_frame(running.talk.index, running.talk.subindex, ABORT_GENERAL)
            self.link.send(SDO_REQUEST + self.node_id, abort, STOP_SEND_S)
        (frame,) = next(download(Conversation(self.index_of(entry), entry.subindex), entry.pack(value)))
        self.link.send(SDO_REQUEST + self.node_id, frame, STOP_SEND_S)

    # -- values ----------------------------------------------------------------------------------------------------
    def index_of(self, entry: Entry) -> int:
        """The index of an object of the standard in this axis."""
        return entry.index + self._offset if entry.index in FIRST_AXIS else entry.index

    def read(self, entry: Entry) -> int:
        """Read an integer object. Raises AbortError, NoAnswerError, ProtocolError, LinkLostError."""
        return self.run(self.getting(entry))

    def getting(self, entry: Entry, *, once: bool = False) -> Steps[int]:
        """As `read`. once: not repeated."""
        data = yield from self.reading(self.index_of(entry), entry.subindex, most_bytes(entry), once=once)
        value = entry.unpack(data)
        if not isinstance(value, int):
            raise ProtocolError(f"{self.name}: {entry} is no integer: {value!r}")
        return value

    def read_if_there(self, entry: Entry, absent: Absent) -> int | Absent:
        """Read an integer object; `absent` where the device answers that it does not exist. Raises as `read`, AbortError too for one
        that exists and is refused."""
        try:
            return self.read(entry)
        except AbortError as error:
            if error.code in OBJECT_MISSING:
                return absent
            raise

    def read_if_shown(self, entry: Entry, absent: Absent) -> int | Absent:
        """Read an integer object; `absent` where the device refuses it, for any reason. Raises as `read`, but not AbortError."""
        try:
            return self.read(entry)
        except AbortError:
            return absent

    def write(self, entry: Entry, value: float) -> None:
        """Write a numeric object; returns once the device has accepted it. Raises InputError, and as `write_bytes`."""
        self.run(self.putting(entry, value))

    def putting(self, entry: Entry, value: float) -> Steps[None]:
        """As `write`."""
        index, data = self.index_of(entry), entry.pack(value)
        try:
            yield from self.writing(index, entry.subindex, data, same=entry.same)
        except AbortError as error:
            wide = (yield from self._as_wide_as_shown(index, entry, value)) if error.code in WRONG_LENGTH else None
            if wide is None:
                raise
            yield from self.writing(index, entry.subindex, wide)

    def _as_wide_as_shown(self, index: int, entry: Entry, value: float) -> Steps[bytes | None]:
        """The value with as many bytes as the device answers for the object; None where that is not another width."""
        shown = len((yield from self.reading(index, entry.subindex, most_bytes(entry))))
        if shown == entry.type.size or not 1 <= shown <= 8 or not isinstance(value, int):
            return None
        try:
            return value.to_bytes(shown, "little", signed=entry.type.is_signed)
        except OverflowError:
            return None

    # -- bytes -----------------------------------------------------------------------------------------------------
    def read_bytes(self, index: int, subindex: int, *, block: bool = False, most: int = LARGEST_ANNOUNCED) -> bytes:
        """Read an object of at most `most` bytes. A read is repeated once after a time-out: reading twice changes nothing.

        Raises AbortError, NoAnswerError, ProtocolError, LinkLostError.
        """
        return self.run(self.reading(index, subindex, most, block=block))

    def write_bytes(
        self,
        index: int,
        subindex: int,
        data: bytes,
        *,
        block: bool = False,
        timeout_s: float | None = None,
        same: Same = operator.eq,
    ) -> None:
        """Write an object and make sure of the outcome.

        same: how bytes read back are compared after a lost answer; without a type they have to be equal, and as many.
        Raises AbortError when the device refuses, NoAnswerError when it did not answer and reading back shows (or cannot
        show) that the value was not written, LinkLostError.
        """
        self.run(self.writing(index, subindex, data, block=block, timeout_s=timeout_s, same=same))

    def run(self, steps: Steps[T]) -> T:
        """Run an access to its end, as `CanLine.run` does for several nodes."""
        with self.link.talking, contextlib.closing(steps):
            while True:
                try:
                    step = next(steps)
                except StopIteration as stop:
                    result: T = stop.value
                    return result
                if isinstance(step, Pause):
                    self.link.wait(step.done, step.duration_s)
                elif isinstance(step, Running):
                    self._carry_out(step)

    def _carry_out(self, running: Running[Any]) -> None:
        """Run a transfer until it is finished or its time is over. Raises LinkLostError, StateError where the channel is in use."""
        try:
            self.begin(running)
        except (TransportError, ProtocolError) as error:
            running.fail(error)
            return
        try:
            while not running.finished:
                wait_for_any(self.link, [running])
        finally:
            self.end()

    # -- bytes, as steps: for this client alone, or side by side with the work of other nodes (`CanLine`) -----------------
    def reading(
        self, index: int, subindex: int, most: int = LARGEST_ANNOUNCED, *, block: bool = False, once: bool = False
    ) -> Steps[bytes]:
        """As `read_bytes`. once: not repeated."""
        repeated = not once and (self.way_out is None or self.way_out.repeats(1, silent=self._silent))
        for last in (False, True) if repeated else (True,):
            talk = Conversation(index, subindex)
            running = Running(self, talk, block_upload(talk, most=most) if block else upload(talk, most))
            yield from self._turn(running)
            if last or not isinstance(running.error, NoAnswerError):
                break
        result = running.outcome()
        if result is None:
            raise ProtocolError(f"{self.name}: SDO {running.talk.place()} ended without data")
        return result

    def writing(
        self,
        index: int,
        subindex: int,
        data: bytes,
        *,
        block: bool = False,
        timeout_s: float | None = None,
        reads_back: bool = True,
        same: Same = operator.eq,
    ) -> Steps[None]:
        """As `write_bytes`. reads_back: the object shows what was written; a command such as 1010h does not."""
        talk = Conversation(index, subindex)
        running = Running(self, talk, block_download(talk, data) if block else download(talk, data), timeout_s)
        yield from self._turn(running)
        lost = running.error
        if not isinstance(lost, NoAnswerError):
            running.outcome()
            return
        with self._unknown(lost), self._late_answers() as late:
            yield from self._quiet()
        if self._settled(talk, data, lost, late):
            return
        if not reads_back:
            raise type(lost)(f"{lost}; whether it was done is unknown") from lost
        with self._unknown(lost):
            present = yield from self.reading(index, subindex)
        if not same(present, data):
            raise type(lost)(f"{lost}; it reads back {present.hex()}, not {data.hex()}: not written") from lost
        self.counters.writes_read_back += 1

    def _turn(self, running: Running[Any]) -> Steps[None]:
        yield from self._quiet()
        yield running

    # -- writes whose answer was lost ----------------------------------------------------------------------------------
    @contextlib.contextmanager
    def _late_answers(self) -> Iterator[list[bytes]]:
        answers: list[bytes] = []
        self._late = answers.append
        try:
            yield answers
        finally:
            self._late = None

    @staticmethod
    @contextlib.contextmanager
    def _unknown(lost: NoAnswerError) -> Iterator[None]:
        try:
            yield
        except (RemoteError, NoAnswerError) as error:
            raise type(lost)(f"{lost}; whether it was written is unknown ({error})") from lost

    def _settled(self, talk: Conversation, data: bytes, lost: NoAnswerError, late: Sequence[bytes]) -> bool:
        """Whether a late answer confirms the write; a late refusal is raised. Only an expedited write has a single answer."""
        for answer in late if 0 < len(data) <= 4 else ():
            if len(answer) == 8 and answer[1:4] == talk.mux and answer[0] == 0x60:
                self.counters.writes_confirmed_late += 1
                return True
            try:
                talk.raise_abort(answer)
            except AbortError as error:
                raise self.named(error) from lost
        return False

    # -- the channel -------------------------------------------------------------------------------------------------
    def _quiet(self) -> Iterator[Pause]:
        """Wait until no frame that could belong to an abandoned transfer has come for `quiet_s`.

        Raises ProtocolError where that does not come within `QUIET_TIMES` + 2 times `quiet_s`. Ends at once where no transfer was
        abandoned.
        """
        if self._abandoned is None:
            return
        heard = self._late_ns
        heard.clear()
        while not self._gives_up:
            count = len(heard)
            yield Pause(self.quiet_s, lambda count=count: len(heard) > count)  # type: ignore[misc]
            if len(heard) == count:
                self._abandoned = None
                return
            if heard[-1] - heard[0] > QUIET_TIMES * self.quiet_s * NS_PER_S:
                raise ProtocolError(f"{self.name}: the SDO channel does not fall silent")

    def reply_s(self) -> float:
        """Longest wait for an answer of a drive that is shut down, s."""
        return math.inf if self.way_out is None else self.way_out.reply_s(silent=self._silent)

    @property
    def _gives_up(self) -> bool:
        return self.way_out is not None and self.way_out.gives_up(silent=self._silent)

    def begin(self, running: Running[Any]) -> None:
        """Give the channel to a transfer and send its first frame. Raises StateError where the channel is in use, NoAnswerError after
        the time limit of shutting down, LinkLostError."""
        if self._running is not None:
            raise StateError(f"{self.name}: the SDO channel is already in use")
        if self._gives_up:
            raise NoAnswerError(
                f"{self.name}: SDO {running.talk.place()} was not tried: the drive has ceased to answer"
            )
        self.link.poll()  # frames in the queue were sent before this request
        self.counters.transfers += 1
        with self._stepping:
            self._running = running
            try:
                running.start()
            except BaseException:
                self._running = None  # nothing was sent: the channel is free for what still works
                raise

    def end(self) -> None:
        """Release the channel and account for the outcome."""
        with self._stepping:
            running = self._running
            self._running = None
            if running is None:
                return
            self._silent = not running.finished
            if self._silent and self.way_out is not None:
                self.way_out.unanswered((running.until_ns - running.began_ns) / NS_PER_S)
            if not running.finished:
                self.counters.timeouts += 1
                self._abandoned = running.talk
                running.abandon()

    def _on_frame(self, time_ns: int, data: bytes) -> None:
        with self._stepping:
            if self._running is not None and not self._running.finished:
                self._running.on_frame(time_ns, data)
                return
        if self._abandoned is not None and self._abandoned.may_answer(data):
            self._late_ns.append(time_ns)
        if self._late is not None:
            self._late(data)


def wait_for_any(link: CanLink, waiting: Sequence[Awaited]) -> None:
    """Wait until one of them is finished, by a frame or because its time is over. Raises LinkLostError."""

    def ended() -> bool:
        return any(each.finished for each in waiting)

    first_ns = min(each.until_ns for each in waiting)
    if link.wait(ended, max(0, first_ns - link.clock.now_ns()) / NS_PER_S):
        return
    link.poll()  # if the loop was delayed, frames may be waiting in the receive buffer
    now_ns = max(first_ns, link.clock.now_ns())  # the wait counts in full, even where it does not advance the clock
    for each in waiting:
        if not each.finished and now_ns >= each.until_ns:
            each.expire()
