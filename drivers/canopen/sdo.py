"""SDO access that can be trusted: guarded against late answers, lost writes and a server that broke off.

What may go in: one `SdoClient` per node over a `CanLink`, and `read_together`, which asks several nodes at once; `side_by_side` keeps
the channels of several nodes busy with work of their own.
An answer counts only when it names the index that was asked for; after a time-out the channel is left quiet before it is used
again; and a write whose answer was lost is resolved by reading back, never by sending it a second time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from drivers.canopen.bus import CanLink
from drivers.canopen.objects import Entry
from drivers.canopen.sdo_transfer import (
    ABORT_TIMEOUT,
    Conversation,
    Transfer,
    abort_frame,
    block_download,
    block_upload,
    download,
    upload,
)
from drivers.errors import AbortError, BridgeError, LinkLostError, NoAnswerError, ProtocolError, StateError

T = TypeVar("T")
SDO_REQUEST = 0x600
SDO_RESPONSE = 0x580


@dataclass
class SdoCounters:
    """What happened on one channel since it was opened."""

    transfers: int = 0
    aborts: int = 0
    timeouts: int = 0
    stale_frames: int = 0  # answers to something that had not been asked, or no longer
    writes_confirmed_late: int = 0  # by an answer that came after the time-out
    writes_read_back: int = 0  # by comparing the object after a time-out


class Running(Generic[T]):
    """One transfer on its way over one channel. timeout_s: how long it may be silent; None: as long as the client says."""

    def __init__(
        self, client: SdoClient, talk: Conversation, transfer: Transfer[T], timeout_s: float | None = None
    ) -> None:
        self.client = client
        self.talk = talk
        self.timeout_s = timeout_s or client.timeout_s
        self._transfer = transfer
        self.finished = False
        self.result: T | None = None
        self.error: BridgeError | None = None

    def start(self) -> None:
        self._step(None)

    def on_frame(self, data: bytes) -> None:
        if not self.finished:
            self._step(data)

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
        self.finished = True
        for frame in self.talk.farewell:
            self.client.transmit(frame)

    def abandon(self) -> None:
        """Time is up: tell the server, and let the transfer go."""
        self._transfer.close()
        self.finished = True
        self.error = NoAnswerError(f"{self.client.name}: SDO {self.talk.place()} was not answered in time")
        with contextlib.suppress(LinkLostError):  # whoever waited has been told about a dead bus already
            self.client.transmit(abort_frame(self.talk.index, self.talk.subindex, ABORT_TIMEOUT))


class SdoClient:
    """The default SDO channel of one node.

    timeout_s: how long one answer may take. quiet_s: how long the channel must have been silent after a time-out before it is
    used again; an answer that comes in that time is late, not lost.
    """

    def __init__(self, link: CanLink, node_id: int, name: str, *, timeout_s: float = 0.5, quiet_s: float = 0.2) -> None:
        self.link = link
        self.node_id = node_id
        self.name = name
        self.timeout_s = timeout_s
        self.quiet_s = quiet_s
        self.counters = SdoCounters()
        self._running: Running[bytes] | Running[None] | None = None
        self._frames = 0
        self._late: Callable[[bytes], None] | None = None
        self._must_be_quiet = False
        link.subscribe(SDO_RESPONSE + node_id, self._on_frame)

    def close(self) -> None:
        """Stop listening."""
        self.link.unsubscribe(SDO_RESPONSE + self.node_id, self._on_frame)

    def named(self, error: BridgeError) -> BridgeError:
        """The same error with the device's name before it."""
        if isinstance(error, AbortError):
            return AbortError(f"{self.name}: {error}", error.code)
        return type(error)(f"{self.name}: {error}")

    def transmit(self, frame: bytes) -> None:
        self.link.send(SDO_REQUEST + self.node_id, frame)

    # -- values ----------------------------------------------------------------------------------------------------
    def read(self, entry: Entry) -> int:
        """Read an integer object. Raises AbortError, NoAnswerError, ProtocolError, LinkLostError."""
        value = entry.unpack(self.read_bytes(entry.index, entry.subindex))
        if not isinstance(value, int):
            raise ProtocolError(f"{self.name}: {entry} is no integer: {value!r}")
        return value

    def read_or(self, entry: Entry, absent: int) -> int:
        """Read an integer object; `absent` where the device says that it does not exist."""
        try:
            return self.read(entry)
        except AbortError as error:
            if error.code in (0x06020000, 0x06090011):
                return absent
            raise

    def read_text(self, entry: Entry) -> str:
        """Read a string object."""
        return str(entry.unpack(self.read_bytes(entry.index, entry.subindex)))

    def write(self, entry: Entry, value: float) -> None:
        """Write a numeric object; returns once the device has taken it. Raises as `write_bytes`."""
        self.write_bytes(entry.index, entry.subindex, entry.pack(value))

    # -- bytes -----------------------------------------------------------------------------------------------------
    def read_bytes(self, index: int, subindex: int, *, block: bool = False) -> bytes:
        """Read an object. A read is repeated once after a time-out: asking twice changes nothing."""
        try:
            return self._upload(index, subindex, block)
        except NoAnswerError:
            return self._upload(index, subindex, block)

    def write_bytes(
        self,
        index: int,
        subindex: int,
        data: bytes,
        *,
        block: bool = False,
        timeout_s: float | None = None,
        reads_back: bool = True,
    ) -> None:
        """Write an object, and be sure about it. reads_back: the object shows what was written; a command such as 1010h does not.

        Raises AbortError when the device refuses, NoAnswerError when it did not answer and reading back shows (or cannot
        show) that the value was not taken.
        """
        talk = Conversation(index, subindex)
        transfer = block_download(talk, data) if block else download(talk, data)
        running = Running(self, talk, transfer)
        try:
            _run([running], timeout_s or self.timeout_s)
            _result(running)
        except NoAnswerError as lost:
            self.resolve(talk, data, lost, reads_back)

    def _upload(self, index: int, subindex: int, block: bool) -> bytes:
        talk = Conversation(index, subindex)
        running = Running(self, talk, block_upload(talk) if block else upload(talk))
        _run([running], self.timeout_s)
        result = _result(running)
        if result is None:
            raise ProtocolError(f"{self.name}: SDO {talk.place()} ended without data")
        return result

    def resolve(self, talk: Conversation, data: bytes, lost: NoAnswerError, reads_back: bool) -> None:
        """A write was not answered: was it carried out? Returns when it was; raises AbortError, NoAnswerError."""
        answers: list[bytes] = []
        self._late = answers.append
        try:
            self.quieten()
        finally:
            self._late = None
        for answer in answers:
            if len(answer) == 8 and answer[1:4] == talk.mux and len(data) <= 4:
                if answer[0] == 0x60:
                    self.counters.writes_confirmed_late += 1
                    return
                try:
                    talk.raise_abort(answer)
                except AbortError as error:
                    raise self.named(error) from lost
        if not reads_back:
            raise NoAnswerError(f"{lost}; whether it was done is unknown") from lost
        try:
            present = self._upload(talk.index, talk.subindex, block=False)
        except (AbortError, NoAnswerError) as error:
            raise NoAnswerError(f"{lost}; whether it was written is unknown ({error})") from lost
        if present[: len(data)] != data:
            raise NoAnswerError(f"{lost}; it reads back {present.hex()}, not {data.hex()}: not written") from lost
        self.counters.writes_read_back += 1

    # -- the channel -------------------------------------------------------------------------------------------------
    def quieten(self) -> None:
        """Wait until the channel has been silent for `quiet_s`; ten times that at most."""
        for _ in range(10):
            seen = self._frames
            if not self.link.wait(lambda seen=seen: self._frames != seen, self.quiet_s):  # type: ignore[misc]
                self._must_be_quiet = False
                return
        raise ProtocolError(f"{self.name}: the SDO channel does not fall silent")

    def begin(self, running: Running[bytes] | Running[None]) -> None:
        """Give the channel to a transfer and send its first frame."""
        if self._running is not None:
            raise StateError(f"{self.name}: the SDO channel is already in use")
        if self._must_be_quiet:
            self.quieten()
        self.link.poll()  # whatever lies in the queue was sent before this request
        self._running = running
        self.counters.transfers += 1
        running.start()

    def end(self) -> None:
        """Take the channel back and account for what happened."""
        running = self._running
        self._running = None
        if running is None:
            return
        self.counters.stale_frames += running.talk.skipped
        if isinstance(running.error, AbortError):
            self.counters.aborts += 1
        if not running.finished:
            self.counters.timeouts += 1
            self._must_be_quiet = True
            running.abandon()

    @property
    def progress(self) -> int:
        """Frames heard so far: a transfer that still moves is not timed out."""
        return self._frames

    def _on_frame(self, _time_ns: int, data: bytes) -> None:
        self._frames += 1
        if self._running is not None and not self._running.finished:
            self._running.on_frame(data)
        elif self._late is not None:
            self._late(data)
        else:
            self.counters.stale_frames += 1


def _result(running: Running[T]) -> T | None:
    if running.error is not None:
        raise running.error
    return running.result


def _run(transfers: Sequence[Running[bytes] | Running[None]], timeout_s: float) -> None:
    """Run transfers of *different* nodes side by side; each may be silent for `timeout_s` at most."""
    link = transfers[0].client.link
    try:
        for running in transfers:
            running.client.begin(running)
        while any(not running.finished for running in transfers):
            before = [running.client.progress for running in transfers]

            def moved(before: list[int] = before) -> bool:
                return before != [running.client.progress for running in transfers] or all(
                    running.finished for running in transfers
                )

            if not link.wait(moved, timeout_s):
                break
    finally:
        for running in transfers:
            running.client.end()


def read_together(requests: Sequence[tuple[SdoClient, Entry]], timeout_s: float = 0.5) -> list[int | BridgeError]:
    """Read one integer object from each of several nodes at once: N nodes cost little more wire time than one.

    The answer of each request stands in its place: the value, or the error that this node gave.
    """
    transfers: list[Running[bytes] | Running[None]] = []
    for client, entry in requests:
        talk = Conversation(entry.index, entry.subindex)
        transfers.append(Running(client, talk, upload(talk)))
    if not transfers:
        return []
    _run(transfers, timeout_s)
    results: list[int | BridgeError] = []
    for running, (client, entry) in zip(transfers, requests, strict=True):
        if running.error is not None:
            results.append(running.error)
            continue
        try:
            value = entry.unpack(running.result or b"")
        except ProtocolError as error:
            results.append(client.named(error))
            continue
        results.append(value if isinstance(value, int) else ProtocolError(f"{client.name}: {entry} is no integer"))
    return results
