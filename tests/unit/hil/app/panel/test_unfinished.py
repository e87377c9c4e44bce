"""Interrupted work in an axis's folder, for the card of the screen."""

from pathlib import Path

from support.bench_axis import lay_out

from hil.app.panel.pages import pages
from hil.app.panel.unfinished import unfinished_work
from hil.axis.axis_file import load_axis
from hil.desk.unfinished import UnfinishedWork
from hil.records.journal import Campaign


def test_an_interrupted_calibration_is_found_until_it_is_finished(tmp_path: Path) -> None:
    axis = load_axis(lay_out(tmp_path))
    assert unfinished_work(axis, pages(None)) == ()
    campaign = Campaign.numbered(axis.store.directory, axis.purpose("calibrate"), resume=False)
    assert unfinished_work(axis, pages(None)) == ()  # nothing was measured
    with campaign.rows("measure", ["run", "direction", "target_mm", "measured_mm"]):
        pass
    assert unfinished_work(axis, pages(None)) == (UnfinishedWork("calibrate", "calibrate", "calibrate-001"),)
    campaign.finish()
    (axis.store.directory / "backlash-before.json").write_text("{}")
    assert unfinished_work(axis, pages(None)) == (UnfinishedWork("settings", "backlash", "X-campaign"),)
