"""The bound of the stop at a few moments; all of them, and in real time, by `python tests/study/stop_latency.py`."""

from __future__ import annotations

import pytest
from hostile.stops import BOUND_REQUESTS, BOUND_S, stopped_at

pytestmark = pytest.mark.outside


@pytest.mark.parametrize(
    ("verb", "sdo_dead", "share"),
    [
        *(("verify", False, 0.21), ("doctor", False, 0.48), ("circle", False, 0.83)),
        *(("verify", True, 0.83), ("doctor", True, 0.21), ("circle", True, 0.48)),
    ],
)
def test_on_can_a_stop_leaves_within_20_ms(verb: str, sdo_dead: bool, share: float) -> None:
    found = stopped_at("canopen", verb, share, sdo_dead=sdo_dead)
    assert found.latency_s <= BOUND_S


@pytest.mark.parametrize(("verb", "share"), [("verify", 0.21), ("calibrate", 0.48), ("verify", 0.83)])
def test_on_modbus_a_stop_waits_for_one_request_at_most(verb: str, share: float) -> None:
    found = stopped_at("modbus-tcp", verb, share)
    assert found.latency_s <= BOUND_S
    assert found.requests <= BOUND_REQUESTS
