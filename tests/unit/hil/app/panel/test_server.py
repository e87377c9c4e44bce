"""The end of the server by a signal."""

from __future__ import annotations

import signal
import threading
from typing import Any, cast

import pytest
import uvicorn

from hil.app.panel.server import Server


class Axis:
    """A desk whose stop needs a lock."""

    def __init__(self) -> None:
        self.lock, self.stopped = threading.Lock(), threading.Event()

    def stop(self) -> None:
        with self.lock:
            self.stopped.set()


@pytest.mark.parametrize("sig", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_every_axis_whatever_it_interrupts(sig: signal.Signals) -> None:
    """It comes in the main thread, which may hold the lock just then."""
    axes = [Axis(), Axis()]
    server = Server(uvicorn.Config(cast(Any, None)), cast(Any, axes))
    with axes[0].lock:
        server.handle_exit(sig, None)
        server.handle_exit(sig, None)
    assert all(axis.stopped.wait(20.0) for axis in axes)
    assert server.should_exit
