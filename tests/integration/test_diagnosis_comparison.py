"""The diagnosis beside the usual ways to choose among columns (`tests/study/comparison.py`), on the same machines."""

from __future__ import annotations

from itertools import chain

import pytest

pytest.importorskip("sklearn", reason="NOT COMPARED: scikit-learn is not installed (pip install -e .[test])")

from study.comparison import OURS, ask_all, by_method, mixed_cases
from study.comparison_methods import METHODS, available


@pytest.mark.slow
def test_we_are_ahead_of_each_in_right_effects_false_findings_and_fresh_error() -> None:
    """The first 10 machines of `python tests/study/comparison.py --machines 140`."""
    figures = by_method(chain.from_iterable(ask_all(mixed_cases(140, seed=3)[:10], workers=2)))
    assert set(figures) == {OURS, *available()}
    ours = figures.pop(OURS)
    assert ours["right effect first"] >= 0.85
    for name, theirs in figures.items():
        for figure in ("right effect first", "both of two effects"):
            assert ours[figure] >= theirs[figure], (name, figure)
        assert ours["every effect named and nothing else"] > theirs["every effect named and nothing else"], name
        assert ours["clean machine: false finding"] <= theirs["clean machine: false finding"], name
        false = "any machine: something named that is not there"
        assert ours[false] < theirs[false], name
        for figure in ("fresh RMS / noise, median", "fresh RMS / noise, 90 %"):
            assert ours[figure] < theirs[figure], (name, figure)


def test_what_is_not_installed_is_said_loudly() -> None:
    absent = set(METHODS) - set(available())
    if absent:
        pytest.skip(f"NOT COMPARED: {', '.join(sorted(absent))} (pip install -e .[test])")
