"""A sample of interrupted and resumed runs; all of them by `python tests/study/broken_off.py`."""

from __future__ import annotations

import pytest
from hostile.kills import HOMING, POWER, WAYS, Break, breaks, run

FEW = [
    Break("verify", method, way, share, number)
    for number, (method, way, share) in enumerate(
        (method, way, 0.55 + 0.1 * turn) for turn, way in enumerate(WAYS) for method in HOMING
    )
]


@pytest.mark.outside
@pytest.mark.parametrize("case", [pytest.param(case, id=str(case)) for case in FEW])
def test_resumed_or_refused_and_no_row_in_another_frame(case: Break) -> None:
    assert run(case).complaints == []


@pytest.mark.outside
@pytest.mark.parametrize(
    "case", [pytest.param(case, id=str(case)) for case in breaks(1, ("calibrate", "lost-motion", "close-loop"))]
)
def test_whatever_verb_was_broken_off(case: Break) -> None:
    assert run(case).complaints == []


def test_where_the_zero_is_gone_a_resume_is_refused() -> None:
    """The counter starts at the present position, and nothing homes it: rows measured there would belong to another zero."""
    found = run(Break("verify", "none", POWER, 0.8, 1))
    assert found.ended != "done", found
    assert found.complaints == [], found
