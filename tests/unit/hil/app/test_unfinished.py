"""Interrupted work in an axis's folder, for the card of the screen."""

from pathlib import Path

from support.bench_axis import lay_out

from hil.app.unfinished import unfinished_work
from hil.axis.axis_file import load_axis
from hil.desk.unfinished import UnfinishedWork
from hil.records.journal import Campaign


def test_an_interrupted_calibration_is_found_until_it_is_finished(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    assert unfinished_work(axis) == ()
    campaign = Campaign.numbered(axis.store.directory, axis.purpose("calibrate"), resume=False)
    assert unfinished_work(axis) == ()  # nothing was measured
    with campaign.rows("measure", ["run", "direction", "target_mm", "measured_mm"]):
        pass
    assert unfinished_work(axis) == (UnfinishedWork("calibrate", "calibrate", "calibrate-001"),)
    campaign.finish()
    (axis.store.directory / "backlash-before.json").write_text("{}")
    assert unfinished_work(axis) == (UnfinishedWork("settings", "backlash", "X-campaign"),)
