"""The canopen package as another node on the bus: its network on a virtual channel, without its log lines."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import canopen


@contextmanager
def quiet() -> Iterator[None]:
    """Silence its log, which repeats what it raises; the tests check what is raised."""
    logging.getLogger("canopen").setLevel(logging.CRITICAL)
    yield
    logging.getLogger("canopen").setLevel(logging.NOTSET)


def network(stack: ExitStack, channel: str) -> canopen.Network:
    """A network that is connected until the stack ends."""
    theirs = canopen.Network()
    theirs.NOTIFIER_CYCLE = 0.05
    theirs.connect(interface="virtual", channel=channel)
    stack.callback(theirs.disconnect)
    return theirs
