"""Sync: ownership of SYNC on one CAN bus. It has one owner, as a second SYNC would pace a stream at the wrong moments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from drivers.canopen.pdo import PdoSpec
from drivers.clock import NS_PER_S, Clock
from drivers.errors import StateError

SYNC = 0x080
LISTEN_S = 0.05
"""Time a link listens before its first SYNC, s: the period of the slowest plausible stream (20 Hz)."""
SYNC_SILENCE_S = 1.0
"""Silence of a foreign SYNC after which this link may send it, s; one sample a second is the slowest rate of a panel."""
SYNC_STEP_S = 0.02
"""Added to the silence per node id, s: of two waiting links the one with the lower node id sends SYNC first."""
SYNC_FRESH_S = 0.1
"""A foreign SYNC within this time is that of a stream or of quick sampling, s: its next one comes without our help."""
CLAIM_S = 0.2
"""How long a stream listens after it has claimed SYNC from another producer, s: four periods of `LISTEN_S`."""
YIELD_S = 0.02
"""Time after the claim within which a link that only samples may still send a SYNC, s."""


class SyncFollower(Protocol):
    """Receiver of SYNC on a link without a stream: the sampled TPDOs of one drive."""

    @property
    def node_id(self) -> int: ...

    @property
    def specs(self) -> Sequence[PdoSpec]: ...

    def leave_sync(self) -> bool:
        """Take the TPDOs out of SYNC; False when they stay in it."""


class Sync:
    """Ownership of SYNC on one bus: a stream on this link; else another link or program that was heard; else this link.

    While it is `taken`, drives are sampled by SDO and their TPDOs do not answer SYNC, so that none of them adds unplanned load to a
    stream. Two links that only sample converge: each stops sending when it hears the other, and sends again after a
    silence whose length depends on its lowest node id.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._stream: object | None = None
        self._foreign_ns: int | None = None  # time of the last SYNC of another producer
        self._begin_ns = clock.now_ns()  # begin of listening
        self.followers: list[SyncFollower] = []

    def heard(self, time_ns: int, _data: bytes) -> None:
        """A SYNC was received, at `time_ns`; those that this link sends are not reported here."""
        if self._stream is None:
            self._foreign_ns = time_ns

    def reset(self) -> None:
        """The bus was opened: forget what was heard."""
        self._foreign_ns, self._begin_ns = None, self._clock.now_ns()

    @property
    def unheard_s(self) -> float:
        """How long this link must still listen before it may send a first SYNC, s."""
        return max(0.0, LISTEN_S - (self._clock.now_ns() - self._begin_ns) / NS_PER_S)

    @property
    def streaming(self) -> bool:
        """Whether a stream on this link owns SYNC."""
        return self._stream is not None

    @property
    def taken(self) -> bool:
        """Whether this link must not send SYNC to sample."""
        if self._stream is not None:
            return True
        if self._foreign_ns is None:
            return False
        lowest = min((follower.node_id for follower in self.followers), default=0)
        return self._clock.now_ns() - self._foreign_ns <= (SYNC_SILENCE_S + SYNC_STEP_S * lowest) * NS_PER_S

    @property
    def foreign_runs(self) -> bool:
        """Whether another link or program sends SYNC so often that its next one can be waited for."""
        return self._foreign_ns is not None and self._clock.now_ns() - self._foreign_ns <= SYNC_FRESH_S * NS_PER_S

    def take(self, stream: object) -> None:
        """A stream becomes the owner. Raises StateError while another one is."""
        if self._stream is not None:
            raise StateError(
                "this bus is streaming already: its SYNC belongs to one stream, which several axes may share"
            )
        self._stream = stream

    def release(self, stream: object) -> None:
        """End the ownership of a stream; nothing when it is not the owner."""
        if self._stream is stream:
            self._stream = self._foreign_ns = None
