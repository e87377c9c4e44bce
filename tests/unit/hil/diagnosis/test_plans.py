"""Plan files: what is written is read back, what is wrong is refused with its line."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.errors import InputError
from drivers.limits import DriveLimits
from hil.diagnosis.loop.next_run import runs_of
from hil.diagnosis.next.design import design
from hil.diagnosis.next.planned_run import Means, PlannedPoint
from hil.diagnosis.next.plans import read_plan, to_plan

LIMITS = DriveLimits(0.0, 500.0, 100.0, 500.0)


def test_a_plan_reads_back_as_it_was_written(tmp_path: Path) -> None:
    points = design(Means(10.0, 490.0, levels={"load_kg": (0.0, 60.0)}, by_itself=frozenset({"load_kg"})), 90.0)
    path = tmp_path / "plan.csv"
    path.write_text(to_plan(points, "a comment\nof two lines"))
    assert read_plan(path, LIMITS) == points


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "holds no plan"),
        ("run,direction,target_mm\n", "no rows"),
        ("run,target_mm\n1,2\n", "lacks direction"),
        ("run,direction,target_mm,spead\n1,1,2,3\n", "names 'spead'"),
        ("run,direction,target_mm\n1,0,20\n", r":2: direction is 0, expected \+1 or -1"),
        ("run,direction,target_mm\n1,1\n", ":2: row has 2 columns, expected 3"),
        ("run,direction,target_mm\n1,1,x\n", ":2: target_mm is 'x', expected a number"),
        ("run,direction,target_mm\n1,1,20\n1,1,600\n", ":3: target_mm is 600 mm, expected 0 to 500 mm"),
        ("run,direction,target_mm,overrun_mm\n1,1,5,9\n", ":2: the turn before it is -4 mm"),
        ("run,direction,target_mm,feed_mm_s\n1,1,5,900\n", ":2: overrun_mm 1 or feed_mm_s 900"),
        ("run,direction,target_mm,rest_s\n1,1,5,-3\n", ":2: rest_s is '-3', expected a number >= 0"),
    ],
)
def test_what_is_no_plan_is_refused_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "plan.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=words) as caught:
        read_plan(path, LIMITS)
    assert str(path) in str(caught.value)


def test_a_plan_is_parted_where_something_is_set_or_the_axis_is_warmed() -> None:
    heavy = (("load_kg", 80.0),)
    points = [
        PlannedPoint(1, 1, 20.0, 1.0),
        PlannedPoint(1, 1, 40.0, 1.0, dwell_s=3.0, feed_mm_s=10.0),
        PlannedPoint(2, 1, 20.0, 1.0, strokes_s=60.0),
        PlannedPoint(2, 1, 40.0, 1.0),
        PlannedPoint(3, 1, 20.0, 1.0, levels=heavy),
        PlannedPoint(3, 1, 40.0, 1.0, levels=heavy),
    ]
    runs = runs_of(points)
    assert [len(run.steps) for run in runs] == [2, 2, 2]
    assert [run.strokes_s for run in runs] == [0.0, 60.0, 0.0]
    assert runs[2].conditions == heavy
    assert (runs[0].steps[1].feed_mm_s, runs[0].steps[1].dwell_s) == (10.0, 3.0)
