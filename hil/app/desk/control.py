"""Who holds control of the desk: one at a time, by a token nobody can guess.

Everybody sees the same state; what moves or writes asks for the token. Control is free to take when nobody has it or its holder
released it; from a holder who has given no sign of life for a while it can be taken over, by an act of its own.
"""

from __future__ import annotations

import hmac
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from drivers.errors import LocalError

SILENT_S = 15.0
"""After so long without a sign of life control can be taken over."""


class NotInControlError(LocalError):
    """Whoever asks does not hold control, or not any more."""


class ControlHeldError(LocalError):
    """Somebody else holds control."""


@dataclass(frozen=True)
class Holder:
    """Who holds control, by the name he gave; silent_s: since his last sign of life; lost: it can be taken over"""

    name: str
    silent_s: float
    lost: bool


class Control:
    """For any thread. on_change: called, with the lock held, whenever the holder changes: rights that he had end with him."""

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = monotonic_s
        self._lock = threading.RLock()
        self._token: str | None = None
        self._name = ""
        self._seen_s = 0.0
        self.on_change: Callable[[], None] = lambda: None

    def holder(self) -> Holder | None:
        """Who has it; None when it is free."""
        with self._lock:
            if self._token is None:
                return None
            silent_s = self._now_s() - self._seen_s
            return Holder(self._name, silent_s, silent_s > SILENT_S)

    def take(self, name: str) -> str:
        """Control, as a token. Raises ControlHeldError while somebody has it."""
        with self._lock:
            if self._token is not None:
                raise ControlHeldError(f"control is held by {self._name}")
            return self._give(name)

    def take_over(self, name: str) -> str:
        """Control, away from a holder who gives no sign of life. Raises ControlHeldError while he does."""
        with self._lock:
            holder = self.holder()
            if holder is not None and not holder.lost:
                raise ControlHeldError(
                    f"control is held by {holder.name}, who was here {holder.silent_s:.0f} s ago;"
                    f" it can be taken over after {SILENT_S:g} s without a sign of life"
                )
            return self._give(name)

    def _give(self, name: str) -> str:
        self._token, self._name, self._seen_s = secrets.token_urlsafe(32), name, self._now_s()
        self.on_change()
        return self._token

    def release(self, token: str | None) -> None:
        """Give it back. Raises NotInControlError."""
        with self._lock:
            self.require(token)
            self._token = None
            self.on_change()

    def holds(self, token: str | None) -> bool:
        """Whether this token is the one in force."""
        with self._lock:
            return self._token is not None and token is not None and hmac.compare_digest(token, self._token)

    def sign_of_life(self, token: str | None) -> None:
        """The holder is still there; nothing happens for anybody else."""
        with self._lock:
            if self.holds(token):
                self._seen_s = self._now_s()

    def require(self, token: str | None) -> None:
        """Raise NotInControlError unless this token is the one in force; asking is a sign of life."""
        if not self.holds(token):
            raise NotInControlError("somebody else holds control of the axis, or nobody: take it first")
        self.sign_of_life(token)
