"""The diagnosis beside the usual ways to choose among columns (`tests/study/comparison.py`), on the same machines."""

from __future__ import annotations

from itertools import chain

import pytest

pytestmark = pytest.mark.outside


def test_we_are_ahead_of_each_in_right_causes_wrong_names_and_fresh_error() -> None:
    """The first 12 machines of `python tests/study/comparison.py`, drawn by a generator that was written apart."""
    pytest.importorskip("sklearn", reason="NOT COMPARED: scikit-learn is not installed (pip install -e .[test])")
    from study.comparison import OURS, ask_all, by_method, machines  # noqa: PLC0415  (seconds of imports)
    from study.comparison_methods import BLACK_BOX, available  # noqa: PLC0415

    figures = by_method(chain.from_iterable(ask_all(machines(12, "tuning", 0), workers=2)))
    assert set(figures) == {OURS, *available(), BLACK_BOX}
    ours = figures.pop(OURS)
    box = figures.pop(BLACK_BOX)
    assert box["strong cause named first"]["of"] == 0
    for name, theirs in figures.items():
        for figure in ("strong cause named first", "weak cause named first", "both of two strong causes"):
            assert ours[figure]["share"] >= theirs[figure]["share"], (name, figure)
        whole, wrong = "every cause named, and nothing wrong", "a wrong name, beside or instead"
        assert ours[whole]["share"] > theirs[whole]["share"], name
        assert ours[wrong]["share"] < theirs[wrong]["share"], name
        assert ours["no cause: anything said"]["share"] <= theirs["no cause: anything said"]["share"], name
    for name, theirs in {**figures, BLACK_BOX: box}.items():
        for part in ("median", "90 %"):
            assert ours["fresh RMS / noise"][part] < theirs["fresh RMS / noise"][part], (name, part)
