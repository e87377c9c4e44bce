"""The drives that a contract is asked of."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.drive_rigs import BACKENDS, COUNTS_PER_REV, MARKS, Backend, Rig

from drivers.scaling import AxisScaling

REVERSED = {"in process", "canopen, simulated wire", "modbus tcp, vendor map"}
DIRECTIONS = {1: "direct", -1: "reversed"}


def _drives() -> Iterator[object]:
    for name in BACKENDS:
        yield pytest.param(name, marks=MARKS.get(name, ()), id=_id(name))


def _rigs() -> Iterator[object]:
    """Each drive; with its shaft the other way, which is arithmetic before any frame, one of each wire."""
    for name in BACKENDS:
        for direction, word in DIRECTIONS.items():
            if direction == 1 or name in REVERSED:
                yield pytest.param((name, direction), marks=MARKS.get(name, ()), id=f"{word}-{_id(name)}")


def _id(name: str) -> str:
    return name.replace(" ", "-").replace(",", "")


@pytest.fixture(params=_drives())
def backend(request: pytest.FixtureRequest) -> Backend:
    return BACKENDS[request.param]


@pytest.fixture(params=_rigs())
def rig(request: pytest.FixtureRequest) -> Iterator[Rig]:
    name, direction = request.param
    with BACKENDS[name](AxisScaling(COUNTS_PER_REV, 10.0, direction=direction)) as rig:
        yield rig
