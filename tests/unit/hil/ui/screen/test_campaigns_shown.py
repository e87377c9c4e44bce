"""What the screens of calibration, diagnosis and reports read from an axis's folder; the files are written by hand."""

import json
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.bench_axis import lay_out

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.calibration.explore import Exploration
from hil.calibration.job import with_signs
from hil.calibration.page_data import calibration_screen, latest
from hil.correction.manual import read_signs
from hil.correction.tables import Band, SingleTable
from hil.diagnosis.loop.jobs.plan import unfinished_loop
from hil.diagnosis.loop.jobs.stored import StoredLoop, stored_loop
from hil.diagnosis.page_data import diagnosis_screen
from hil.diagnosis.stored import read_stored, sources, stored_beside
from hil.machine.in_motion_settings import InMotion, feeds_of
from hil.records.journal import measurement_of
from hil.records.rows import Records, to_csv
from hil.report.page_data import axis_history, reports
from hil.ui.screen.campaigns import measurements

ROWS = Iterable[tuple[int, int, float, float]]


def kept(folder: Path, name: str, passes: dict[str, Records], begun: str, **purpose: object) -> Path:
    """A campaign on disk."""
    here = folder / name
    here.mkdir(parents=True)
    (here / "campaign.json").write_text(json.dumps({"kind": name.rpartition("-")[0], "axis": "X", **purpose}))
    for stem, records in passes.items():
        (here / f"{stem}.csv").write_text(f"# begun {begun}\n" + to_csv(records))
    return here


def rows(values: ROWS) -> Records:
    """(run, direction, target mm, error µm)"""
    run, direction, target, error = (np.array(column, dtype=float) for column in zip(*values, strict=True))
    return Records.of({"run": run, "direction": direction, "target_mm": target, "measured_mm": target + error / 1000.0})


@pytest.fixture
def axis(tmp_path: Path) -> AxisConfig:
    return load_axis(lay_out(tmp_path, correction="band_um = [-1.0, 1.0]"))


BEFORE = rows((run, way, x, 10.0 + way) for run in (1, 2) for way in (1, -1) for x in (0.0, 50.0))
FIRST = rows((run, way, x, 3.0 if x and way > 0 else 0.5) for run in (1, 2) for way in (1, -1) for x in (0.0, 50.0))
SECOND = rows((run, 1, 50.0, -0.25) for run in (1, 2))


def test_a_later_round_stands_for_what_lay_outside() -> None:
    found = latest([FIRST, SECOND])
    by_place = {(x, way): error for x, way, error in zip(found.target_mm, found.direction, found.error_um, strict=True)}
    assert by_place == pytest.approx({(0.0, 1.0): 0.5, (50.0, 1.0): -0.25, (0.0, -1.0): 0.5, (50.0, -1.0): 0.5})
    assert len(found) == len(FIRST)


def test_calibration_before_and_after_with_the_band(axis: AxisConfig) -> None:
    folder = axis.store.directory
    here = kept(folder, "calibrate-002", {"measure": BEFORE, "round-1": FIRST}, "2026-03-01T10:00:00+00:00")
    screen = calibration_screen(axis)
    assert set(screen.stages) == {"before", "after"}
    before, after = screen.stages["before"], screen.stages["after"]
    assert np.allclose(before.means_um[1], ((0.0, 11.0), (50.0, 11.0)))
    assert before.figures_um["B"] == pytest.approx(2.0)
    assert before.figures_um["M"] == pytest.approx(0.0, abs=1e-9)
    assert after.outside is not None
    assert [(one.target_mm, one.direction) for one in after.outside] == [(50.0, 1)]
    assert after.sections == 4
    assert before.u95_um == {}  # the axis file says nothing of it
    assert not screen.tables
    assert screen.unfinished == {"calibrate": ("calibrate-002", 1, (), None)}

    (here / "round-2.csv").write_text(to_csv(SECOND))
    (here / "finished").touch()
    kept(folder, "verify-001", {"verify": FIRST}, "2026-03-01T11:00:00+00:00", seed=7)
    screen = calibration_screen(axis)
    assert screen.stages["after"].outside == ()
    assert screen.stages["verified"].begun.isoformat().startswith("2026-03-01")
    assert screen.unfinished == {"verify": ("verify-001", 7, (), None)}


def test_each_stage_is_judged_with_the_signs_that_its_campaign_was_begun_with(axis: AxisConfig) -> None:
    """And what lies between targets of two signs is not judged; the axis file has no signs."""
    first, *_, last = axis.measurement.targets_mm
    inside = rows((run, way, x, way * 10.0) for run in (1, 2) for way in (1, -1) for x in (first, last))
    middle = (first + last) / 2
    places = [(first, 1, 10.0), (first, -1, 10.0), (middle, 1, 10.0), (middle, -1, 0.0)]
    between = rows((run, way, x, error_um) for run in (1, 2) for x, way, error_um in places)
    axis = replace(axis, correction=replace(axis.correction, band=Band(9.0, 11.0)))
    axis = replace(axis, measurement=replace(axis.measurement, targets_mm=(first, last)))
    signed = with_signs(axis, read_signs("x", "from_mm,to_mm,plus,minus\n-1000,1000,1,-1\n"))
    step = with_signs(axis, read_signs("x", f"from_mm,to_mm,plus,minus\n{last},1000,1,-1\n"))
    at, folder = "2026-03-01T10:00:00+00:00", axis.store.directory
    backlash = {"position_mm": [1.0, 2.0], "value_um": [3.0, 4.0]}
    began = {**signed.purpose("calibrate"), "backlash": backlash}
    kept(folder, "calibrate-001", {"measure": between, "round-1": inside}, at, **began)
    kept(folder, "verify-001", {"verify": between}, at, **step.purpose("verify"), seed=3)
    screen = calibration_screen(axis)
    assert screen.stages["after"].outside == ()
    assert screen.stages["after"].band == signed.correction.band
    assert [(one.direction) for one in screen.stages["before"].outside or ()] == [-1, -1]
    verified = screen.stages["verified"]
    assert verified.outside == ()
    assert [(one.target_mm, one.direction) for one in verified.not_judged] == [(middle, -1)]
    assert verified.sections == 3
    resumable = screen.unfinished["calibrate"]
    assert resumable.signs == signed.correction.signs
    assert resumable.backlash == SingleTable(np.array([1.0, 2.0]), np.array([3.0, 4.0]))
    assert screen.unfinished["verify"].signs == step.correction.signs
    assert with_signs(axis, resumable.signs).purpose("calibrate") == signed.purpose("calibrate")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("from_mm,to_mm,plus,minus\n0,10,1,0.5\n", "expected 1 or -1"),
        ("from_mm,to_mm,plus,minus\n0,10,1,-1\n5,20,1,1\n", "have two signs"),
        ("from_mm,to_mm,plus,minus\n10,0,1,1\n", "expected from_mm < to_mm"),
        ("from_mm,to_mm,plus\n0,10,1\n", "header lacks minus"),
        ("from_mm,to_mm,plus,minus\n0,10,1,x\n", "signs.csv:2: minus is"),
    ],
)
def test_signs_that_cannot_be_used(text: str, why: str) -> None:
    with pytest.raises(InputError) as caught:
        read_signs("signs.csv", text)
    assert why in str(caught.value)
    assert "signs.csv" in str(caught.value)
    assert read_signs("signs.csv", "from_mm,to_mm,plus,minus\n") == ()


def test_figures_come_with_what_the_axis_file_says_of_the_instrument(tmp_path: Path) -> None:
    path = lay_out(tmp_path)
    path.write_text(path.read_text() + "\n[uncertainty]\nvariation_um = 1.7320508\n")
    axis = load_axis(path)
    level = rows((run, way, x, 10.0 + way) for run in (1, 2) for way in (1, -1) for x in (0.0, 50.0, 100.0))
    kept(axis.store.directory, "calibrate-001", {"measure": level}, "2026-03-01T10:00:00+00:00")
    # alike at all targets, so that another choice changes nothing; U_EVE = 1.732/sqrt(3) = 1 µm, n = 2:
    # U(R) = sqrt(4 + 2/2), U(E) = sqrt(2/2), U(A) = sqrt(1 + 4)
    u95 = calibration_screen(axis).stages["before"].u95_um
    assert [u95[name] for name in ("R", "E", "A")] == pytest.approx([5**0.5, 1.0, 5**0.5], rel=1e-6)


def test_an_axis_that_was_never_measured(axis: AxisConfig) -> None:
    assert calibration_screen(axis).stages == {}
    assert measurements(axis.store.directory) == []
    assert axis_history(axis.store.directory, "X") is None
    assert reports(axis.store.directory) == []
    assert diagnosis_screen(axis).chosen is None


@pytest.mark.parametrize(
    ("stem", "name"),
    [("before-3", "before"), ("next-2-1", "next-2"), ("motion-after-1", "motion-after"), ("round-1", "round-1")],
)
def test_runs_of_one_exploration_are_one_measurement(stem: str, name: str) -> None:
    assert measurement_of(stem) == name


def test_measurements_the_newest_first(tmp_path: Path) -> None:
    kept(tmp_path, "verify-001", {"verify": FIRST}, "2026-03-01T10:00:00+00:00")
    kept(tmp_path, "close-loop-001", {"before-1": FIRST, "before-2": BEFORE}, "2026-04-01T10:00:00+00:00")
    (tmp_path / "close-loop-001" / "before-3.csv").write_text("run,direction,target_mm,measured_mm\n")  # no row yet
    first, second = measurements(tmp_path)
    assert (first.key, first.rows, [path.name for path in first.paths]) == (
        "close-loop-001/before",
        len(FIRST) + len(BEFORE),
        ["before-1.csv", "before-2.csv"],
    )
    assert stored_beside(first.paths) == tmp_path / "close-loop-001" / "before.diagnosis.json"
    assert (second.key, second.kind, second.state) == ("verify-001/verify", "verify", "open")
    assert second.figures_um["B"] == pytest.approx(2.5)


def test_history_counts_days_and_has_its_trend(tmp_path: Path) -> None:
    for month, error in enumerate((1.0, 2.0, 3.0)):
        worse = rows((run, way, x, error * way) for run in (1, 2) for way in (1, -1) for x in (0.0, 50.0))
        kept(tmp_path, f"verify-{month + 1:03d}", {"verify": worse}, f"2026-03-{1 + 10 * month:02d}T10:00:00+00:00")
    found = axis_history(tmp_path, "X")
    assert found is not None
    assert found.days == pytest.approx((0.0, 10.0, 20.0))
    assert np.allclose(found.points("B"), ((0.0, 2.0), (10.0, 4.0), (20.0, 6.0)))
    assert found.trends["B"] is not None
    assert found.trends["B"].slope_um == pytest.approx(6.0)
    assert np.allclose(found.line("B"), ((0.0, 2.0), (20.0, 6.0)))
    assert axis_history(tmp_path, "Y") is None


def test_reports_the_newest_first_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "reports"
    folder.mkdir()
    for number, name in enumerate(("report-001.html", "report-001.pdf", "history-002.html", "notes.html")):
        (folder / name).touch()
        os.utime(folder / name, (1e9 + number, 1e9 + number))
    assert [(one.name, one.kind, one.paper) for one in reports(tmp_path)] == [
        ("history-002.html", "history", ""),
        ("report-001.html", "report", "report-001.pdf"),
    ]


# -- diagnosis -----------------------------------------------------------------------------------------------------------
FORM = {
    "findings": [
        {
            "effect": "cyclic",
            "confidence": 0.97,
            "action": "compensate",
            "explanation": "it turns",
            "parameters": {"period_mm": {"value": 10.0, "std": 0.01}},
            "rivals": [{"effect": "local_wear", "confidence": 0.03, "separate_by": "a dense sweep"}],
        }
    ],
    "unexplained": True,
    "carried_by": [{"columns": ["temp_screw_c", "target_mm"], "rms_um": 0.8, "rms_std_um": 0.1}],
    "blind_to": [{"effect": "cosine", "reason": "only 1 % of it is left beside the table"}],
    "before": {"rms_um": 2.0, "peak_um": 4.0},
    "after": {"rms_um": 0.5, "peak_um": "much"},
    "held_out": {"rows": 8},
    "recommended": True,
    "noise_floor_um": 0.3,
    "next_measurement": {"what": "a dense sweep"},
    "drawn": {
        "position": {
            "label": "x",
            "over": "y",
            "residual": {"+": [[1, 2], ["no", 3]]},
            "laid_over": {},
            "smooth": True,
        },
        "findings": [],
    },
}


def test_a_stored_diagnosis_is_shown_as_far_as_it_goes(axis: AxisConfig) -> None:
    here = kept(axis.store.directory, "verify-001", {"verify": FIRST}, "2026-03-01T10:00:00+00:00")
    kept(axis.store.directory, "verify-002", {"verify": FIRST}, "2026-03-02T10:00:00+00:00")
    stored = here / "verify.diagnosis.json"
    stored.write_text(json.dumps(FORM | {"sources": sources([here / "verify.csv"])}))
    screen = diagnosis_screen(axis)
    assert screen.chosen is not None
    assert screen.chosen.key == "verify-001/verify"  # the one that has a diagnosis, though there is a newer one
    shown = screen.shown
    assert shown is not None
    assert shown.current
    assert (shown.rms_um, shown.peak_um) == ({"before": 2.0, "after": 0.5}, {"before": 4.0})
    assert (shown.unexplained, shown.recommended, shown.next_run) == (True, True, "a dense sweep")
    assert shown.carriers == ((("Temp screw", "Target"), 0.8, 0.1),)
    finding = shown.findings[0]
    assert (finding.effect, finding.parameters) == ("cyclic", (("period_mm", 10.0, 0.01),))
    assert finding.rivals == (("local_wear", 0.03, "a dense sweep"),)
    assert finding.curves is None
    assert shown.position is not None
    assert shown.position.residual == {1: ((1.0, 2.0),)}

    (here / "verify.csv").write_text(to_csv(BEFORE))
    again = diagnosis_screen(axis, "verify-001/verify").shown
    assert again is not None
    assert not again.current
    assert diagnosis_screen(axis, "verify-002/verify").shown is None


@pytest.mark.parametrize("text", ["no JSON", "[]", '{"findings": []}'])
def test_what_is_no_diagnosis_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.diagnosis.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"JSON|diagnosis"):
        read_stored(path)


# -- the loop ------------------------------------------------------------------------------------------------------------
EXPLORED = {"before-1": BEFORE, "before-2": BEFORE, "before-10": FIRST, "after-1": FIRST}


def test_a_loop_of_before_is_shown_as_far_as_it_was_measured(axis: AxisConfig) -> None:
    folder = axis.store.directory
    assert stored_loop(folder) is None
    purpose = {"exploration": {"runs": 3, "rows": 8, "warm_up_s": 5.0}, "in_motion": {"feeds_mm_s": [20.0, 60.0]}}
    rounds = {"measure": BEFORE, "round-2": FIRST, "round-10": SECOND}
    here = kept(folder, "close-loop-002", rounds | EXPLORED, "2026-03-01T10:00:00+00:00", **purpose)
    (kept(folder, "close-loop-009", {}, "") / "measure.csv").write_text("run,direction,target_mm,measured_mm\n")
    found = stored_loop(folder)
    assert found is not None
    assert (found.place, found.good) == ("close-loop-002", None)
    assert [(stage, one["rows"]) for stage, one in found.stages.items()] == [
        ("uncorrected", len(BEFORE)),
        ("table", len(SECOND)),
        ("table, explored", 2 * len(BEFORE) + len(FIRST)),
        ("extended, explored", len(FIRST)),
    ]
    assert found.stages["table"]["rms_um"] == pytest.approx(0.25)
    (folder / "close-loop-009" / "measure.csv").unlink()
    assert unfinished_loop(folder) == (Exploration(3, 8, 5.0), InMotion((20.0, 60.0)))

    (here / "finished").touch()
    assert stored_loop(folder) == StoredLoop("close-loop-002", found.stages, None)  # it kept no diagnosis
    for unexplained, waiting, good in ((False, None, True), (True, None, False), (False, "somebody has to", False)):
        asked = {"unexplained": unexplained, "next_measurement": {"what": "a run", "person": waiting}}
        (here / "before.diagnosis.json").write_text(json.dumps(FORM | asked))
        assert stored_loop(folder) == StoredLoop("close-loop-002", found.stages, good)
    assert diagnosis_screen(axis).loop == stored_loop(folder)


@pytest.mark.parametrize(("text", "feeds"), [("20,60, 110", (20.0, 60.0, 110.0)), ("20,5; 60", (20.5, 60.0))])
def test_feeds_as_people_type_them(text: str, feeds: tuple[float, ...]) -> None:
    assert feeds_of(text) == feeds


@pytest.mark.parametrize("text", ["", "20", "20,20", "20,-5", "20;fast", "20,inf"])
def test_what_is_no_two_feeds(text: str) -> None:
    with pytest.raises(InputError, match="expected at least two different feeds"):
        feeds_of(text)
