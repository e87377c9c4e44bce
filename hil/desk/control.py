"""Control of a desk: one person at a time may give commands, by a random token.

All browsers see the same state; commands that move or write need the token. Control can be taken while it is free, and taken over
from a holder whose browser has been silent for `SILENT_S`.
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
"""Time without a message from the holder's browser after which control can be taken over, s."""


class NotInControlError(LocalError):
    """The caller does not hold control, or not any more."""


class ControlHeldError(LocalError):
    """Another person holds control."""


@dataclass(frozen=True)
class Holder:
    """The holder, by the name given. silent_s: time since the last message; lost: control can be taken over."""

    name: str
    silent_s: float
    lost: bool


class DeskControl:
    """Control of one desk, for any thread. on_change: called, with the lock held, when the holder changes; it ends the holder's
    rights."""

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s = monotonic_s
        self._lock = threading.RLock()
        self._token: str | None = None
        self._name = ""
        self._seen_s = 0.0
        self.on_change: Callable[[], None] = lambda: None

    def holder(self) -> Holder | None:
        """The holder; None when control is free."""
        with self._lock:
            if self._token is None:
                return None
            silent_s = self._now_s() - self._seen_s
            return Holder(self._name, silent_s, silent_s > SILENT_S)

    def take(self, name: str) -> str:
        """Take control; returns the token. Raises ControlHeldError while it is held."""
        with self._lock:
            if self._token is not None:
                raise ControlHeldError(f"control is held by {self._name}")
            return self._give(name)

    def take_over(self, name: str) -> str:
        """Take control from a silent holder; returns the token. Raises ControlHeldError while the holder is not silent."""
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
        """Release control. Raises NotInControlError for a wrong token."""
        with self._lock:
            self.require(token)
            self._token = None
            self.on_change()

    def holds(self, token: str | None) -> bool:
        with self._lock:
            return self._token is not None and token is not None and hmac.compare_digest(token, self._token)

    def sign_of_life(self, token: str | None) -> None:
        """Note a message from the holder; ignored for any other token."""
        with self._lock:
            if self.holds(token):
                self._seen_s = self._now_s()

    def require(self, token: str | None) -> None:
        """Raises NotInControlError unless this token is the one in force. Counts as a message from the holder."""
        if not self.holds(token):
            raise NotInControlError("this browser does not have control of the axis: take control first")
        self.sign_of_life(token)
