"""The drives that a contract is asked of."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from support.drive_rigs import BACKENDS, COUNTS_PER_REV, MARKS, Backend, Rig

from drivers.scaling import AxisScaling


@pytest.fixture(
    params=[
        pytest.param(name, marks=MARKS.get(name, ()), id=name.replace(" ", "-").replace(",", "")) for name in BACKENDS
    ]
)
def backend(request: pytest.FixtureRequest) -> Backend:
    return BACKENDS[request.param]


@pytest.fixture(params=[1, -1], ids=["direct", "reversed"])
def rig(request: pytest.FixtureRequest, backend: Backend) -> Iterator[Rig]:
    with backend(AxisScaling(COUNTS_PER_REV, 10.0, direction=request.param)) as rig:
        yield rig
