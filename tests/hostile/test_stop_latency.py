"""The bound of the stop at a few moments; all of them, and in real time, by `python tests/study/stop_latency.py`."""

from __future__ import annotations

import pytest
from hostile.stops import BOUND_REQUESTS, BOUND_S, stopped_at

pytestmark = pytest.mark.outside

SHARES = (0.21, 0.48, 0.83)


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("sdo_dead", [False, True], ids=["SDO alive", "SDO dead"])
@pytest.mark.parametrize("verb", ["verify", "doctor", pytest.param("circle")])
def test_on_can_a_stop_leaves_within_20_ms(verb: str, sdo_dead: bool, share: float) -> None:
    found = stopped_at("canopen", verb, share, sdo_dead=sdo_dead)
    assert found.latency_s <= BOUND_S


@pytest.mark.parametrize("share", SHARES)
@pytest.mark.parametrize("verb", ["verify", pytest.param("calibrate")])
def test_on_modbus_a_stop_waits_for_one_request_at_most(verb: str, share: float) -> None:
    found = stopped_at("modbus-tcp", verb, share)
    assert found.latency_s <= BOUND_S
    assert found.requests <= BOUND_REQUESTS
