"""DelayedLine: the delay between a sample and its byte at the reader: conversion, buffers, adapters. Messages keep their order."""

from __future__ import annotations

import random
from collections import deque

from drivers.errors import InputError
from sim_backends.terminal import InstrumentTerminal

_NS = 1_000_000_000
_FAR_NS = 1 << 62


class DelayedLine:
    """Messages go on the wire `latency_s` after their time, and up to `jitter_s` later, evenly distributed; s. Raises InputError."""

    def __init__(self, wire: InstrumentTerminal, latency_s: float = 0.0, jitter_s: float = 0.0, seed: int = 0) -> None:
        if not (latency_s >= 0.0 and jitter_s >= 0.0):
            raise InputError(f"latency {latency_s:g} s with jitter {jitter_s:g} s, expected neither below 0")
        self._wire = wire
        self._latency_ns = round(latency_s * _NS)
        self._jitter_ns = jitter_s * _NS
        self._rng = random.Random(seed)
        self._waiting: deque[tuple[int, bytes]] = deque()

    @property
    def next_ns(self) -> int:
        """Time of the next message, ns; far in the future when none waits."""
        return self._waiting[0][0] if self._waiting else _FAR_NS

    def put(self, message: bytes, time_ns: int) -> None:
        """Queue a message of this time, ns."""
        due_ns = time_ns + self._latency_ns
        if self._jitter_ns:
            due_ns += round(self._rng.uniform(0.0, self._jitter_ns))
        if self._waiting:
            due_ns = max(due_ns, self._waiting[-1][0])
        if due_ns <= time_ns and not self._waiting:
            self._wire.put(message)
        else:
            self._waiting.append((due_ns, message))

    def release(self, now_ns: int) -> None:
        """Put the messages that are due on the wire."""
        while self._waiting and self._waiting[0][0] <= now_ns:
            self._wire.put(self._waiting.popleft()[1])
