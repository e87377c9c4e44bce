"""Fixtures of the tests of hil."""

import os
from collections.abc import Callable, Iterator

import pytest


@pytest.fixture
def as_nobody() -> Iterator[Callable[[], None]]:
    """Call it to lose the right to read everything, should the tests run as root; the right comes back at the end."""
    before = os.geteuid()

    def lose() -> None:
        if before == 0:
            os.seteuid(65534)

    yield lose
    os.seteuid(before)
