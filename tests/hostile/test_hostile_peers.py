"""A sample of the hostile peers; all of them by `python tests/study/hostile_peers.py --all`."""

from __future__ import annotations

import pytest
from hostile.judge import Case, run, sample
from hostile.places import VERBS

QUICK = ("SDO toggle bit stays", "stops sending")
"""Kinds that take a moment of computing, so that the stand-ins for bus and instrument are tried in every run of the tests."""


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(case, id=str(case), marks=() if case.kind in QUICK else pytest.mark.outside)
        for case in sample(1, tuple(VERBS))
    ],
)
def test_it_ends_in_time_with_the_right_error_and_nothing_wrong(case: Case) -> None:
    assert run(case).complaints == []
