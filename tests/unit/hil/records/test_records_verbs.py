"""`hil records`: what is on disk, whether it is as it was left, and an axis over months."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from hil.app.main import main
from hil.correction import WIDE_ISO_CELLS
from hil.figures.history import find_campaigns, history, trend
from hil.figures.reading import RULE
from hil.records.journal import CHECKSUMS, MARKER, Campaign
from hil.records.row_chain import CHAIN, adopt
from hil.records.rows import read_csv

COLUMNS = ("run", "direction", "target_mm", "measured_mm", "time_s", "temp_screw_c")
TARGETS = (0.0, 100.0, 210.0)


def measured(
    directory: Path,
    scale_um: float,
    *,
    name: str = "verify",
    axis: str = "X",
    runs: int = 2,
    begun: datetime | None = None,
) -> Campaign:
    """A campaign whose error grows along the axis to `scale_um`; begun: pretended, put into the pass as a real one would."""
    campaign = Campaign(directory, {"kind": "verify", "axis": axis, "instrument": {"kind": "umd"}}, resume=False)
    with campaign.rows(name, COLUMNS) as journal:
        for run in range(1, runs + 1):
            for direction in (1, -1):
                for target in TARGETS[::direction]:
                    error_um = scale_um * target / TARGETS[-1] + 0.1 * run + 0.5 * direction
                    values = (run, direction, target, target + error_um / 1000.0, 10.0 * len(journal), 22.0)
                    journal.append(dict(zip(COLUMNS, values, strict=True)))
    if begun is not None:
        path = directory / f"{name}.csv"
        lines = path.read_text().splitlines()
        lines[1] = f"# begun {begun.isoformat(timespec='seconds')}"
        path.write_text("\n".join(lines) + "\n")
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        (directory / CHECKSUMS).write_text(f"{digest}  {name}.csv\n")
        (directory / CHAIN).unlink()
        adopt(directory, (directory / MARKER).read_bytes())
    return campaign


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_pass_says_when_it_was_begun_and_is_as_it_was_left(place: Path) -> None:
    before = datetime.now(UTC) - timedelta(seconds=1)
    measured(place / "c", 5.0)
    (campaign,) = find_campaigns(["."])
    (one,) = campaign.passes
    assert before <= one.begun <= datetime.now(UTC)
    assert (one.dated, one.state, campaign.axis, campaign.kind) == (True, "closed", "X", "verify")
    assert main(["records", "inspect", "c", "--json", "i.json"]) == 0
    form = json.loads(Path("i.json").read_text())
    assert form["passes"][0]["sha256"] in (place / "c" / CHECKSUMS).read_text()
    assert form["passes"][0]["rows"] == 12


def test_inspect_names_the_first_line_that_its_chain_does_not_know(
    place: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured(place / "c", 5.0)
    assert main(["records", "inspect", "c"]) == 0
    assert "rows: unchanged (14 lines held against rows.chain)" in capsys.readouterr().out
    path = place / "c" / "verify.csv"
    text = path.read_text()
    path.write_text(text.replace("1,+1,100.0,", "1,+1,100.5,", 1))
    (place / "c" / CHECKSUMS).unlink()  # nothing but the chain knows
    assert main(["records", "inspect", "c", "--json", "i.json"]) == 1
    said = capsys.readouterr().out
    assert re.search(r"verify\.csv:4: is not as it was written", said)
    assert json.loads(Path("i.json").read_text())["chain_good"] is False
    path.write_text(text)
    (place / "c" / CHAIN).unlink()
    assert main(["records", "inspect", "c"]) == 0
    assert "not chained" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("damage", "state", "status"),
    [
        (lambda text: text.replace("210.0", "211.0", 1), "changed", 1),
        (lambda text: text + "3,+1,0.", "torn", 1),
        (lambda text: text.replace("+1,0.0", "+2,0.0", 1), "changed", 1),
        (lambda text: text, "closed", 0),
    ],
)
def test_what_was_changed_since_is_found(place: Path, damage: object, state: str, status: int) -> None:
    measured(place / "c", 5.0)
    path = place / "c" / "verify.csv"
    assert callable(damage)
    path.write_text(damage(path.read_text()))
    assert main(["records", "inspect", "c", "--json", "i.json"]) == status
    assert json.loads(Path("i.json").read_text())["passes"][0]["state"] == state


def test_an_interrupted_pass_and_one_from_before_checksums(place: Path) -> None:
    campaign = measured(place / "c", 5.0)
    with pytest.raises(KeyboardInterrupt), campaign.rows("second", COLUMNS) as journal:  # noqa: PT012
        journal.append(dict(zip(COLUMNS, (1, 1, 0.0, 0.0, 0.0, 20.0), strict=True)))
        raise KeyboardInterrupt
    assert {one.name: one.state for one in find_campaigns(["."])[0].passes} == {"verify": "closed", "second": "closed"}
    (place / "c" / CHECKSUMS).unlink()
    assert {one.state for one in find_campaigns(["."])[0].passes} == {"open"}
    assert main(["records", "inspect", "c"]) == 0


def test_notes_are_said_as_one_would(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    campaign = measured(place / "c", 5.0)
    digest = "2835ac1583ab20e0" + 48 * "f"
    for name in ("second", "third"):
        with campaign.rows(name, COLUMNS, f"tables {digest}") as journal:
            journal.append(dict(zip(COLUMNS, (1, 1, 0.0, 0.0, 0.0, 20.0), strict=True)))
            journal.note(f"1 average: standard deviation of a reading 0.03 um ({RULE})")
    assert main(["records", "inspect", "c"]) == 0
    said = capsys.readouterr().out
    assert said.count(RULE) == 1
    assert said.count("second: ") == 2
    assert "second: tables 2835ac1583ab20e0…\n" in said
    assert "third: 1 average: standard deviation of a reading 0.03 µm\n" in said


def test_list_is_by_date(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)
    for days, name in ((40, "b"), (0, "c"), (80, "a")):
        measured(place / "kept" / name, 5.0, begun=start + timedelta(days=days))
    assert main(["records", "list", ".", "--json", "l.json"]) == 0
    listed = json.loads(Path("l.json").read_text())["campaigns"]
    assert [Path(one["directory"]).name for one in listed] == ["c", "b", "a"]
    assert capsys.readouterr().out.count("verify") >= 3


def test_a_campaign_s_path_is_broken_between_names_alone_in_a_narrow_terminal(
    place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the working directory on, as it is typed in the next command; whole where there is room."""
    measured(place / "workshop" / "campaign" / "verify-001", 5.0, begun=datetime(2026, 3, 1, 8, 0, tzinfo=UTC))
    for width, parts in (
        (140, ["workshop/campaign/verify-001"]),
        (80, ["workshop/campaign/", "verify-001", "2026-03-01", "state"]),
    ):
        monkeypatch.setenv("COLUMNS", str(width))
        assert main(["records", "list", "."]) == 0
        said = capsys.readouterr().out
        assert set(parts) <= {word for line in said.splitlines() for word in line.split()}
        assert max(map(len, said.splitlines())) <= width


def test_merge_numbers_runs_on_and_tells_the_time_by_the_dates(place: Path) -> None:
    start = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)
    measured(place / "late", 5.0, begun=start + timedelta(hours=2))
    measured(place / "early", 4.0, begun=start)
    assert main(["records", "merge", "late/verify.csv", "early/verify.csv", "--out", "both.csv"]) == 0
    both = read_csv("both.csv")
    assert both.runs == [1, 2, 3, 4]
    assert both.error_um[2] == pytest.approx(4.0 + 0.6), "the earlier one first"
    assert both["time_s"].tolist() == [10.0 * i for i in range(12)] + [7200.0 + 10.0 * i for i in range(12)]
    assert "merged from" in Path("both.csv").read_text().splitlines()[0]


def test_merge_of_undated_files_goes_on_where_the_one_before_ended(place: Path) -> None:
    for name in ("a", "b"):
        Path(f"{name}.csv").write_text("run,direction,target_mm,measured_mm,time_s\n1,+1,0,0,5\n1,-1,0,0,9\n")
    assert main(["records", "merge", "a.csv", "b.csv", "--out", "both.csv"]) == 0
    assert read_csv("both.csv")["time_s"].tolist() == [5.0, 9.0, 9.0, 13.0]


@pytest.mark.parametrize("cells", list(WIDE_ISO_CELLS))
@pytest.mark.parametrize("decimal", [".", ","])
def test_a_wide_table_reads_back(place: Path, cells: str, decimal: str) -> None:
    measured(place / "c", 5.0)
    argv = ["records", "export", "c/verify.csv", "--format", "iso-wide", "--cells", cells, "--decimal", decimal]
    assert main([*argv, "--out", "w.csv"]) == 0
    assert (
        main(["import", "w.csv", "--format", "iso-wide", "--cells", cells, "--decimal", decimal, "--out", "back.csv"])
        == 0
    )
    was, back = read_csv("c/verify.csv"), read_csv("back.csv")
    assert back.target_mm.tolist() == was.target_mm.tolist()
    assert back.run.tolist() == was.run.tolist()
    assert np.max(np.abs(back.measured_mm - was.measured_mm)) < 1e-6


def test_export_as_json_and_csv(place: Path) -> None:
    measured(place / "c", 5.0)
    assert main(["records", "export", "c/verify.csv", "--format", "json", "--out", "r.json"]) == 0
    assert len(json.loads(Path("r.json").read_text())["columns"]["time_s"]) == 12
    assert main(["records", "export", "c/verify.csv", "--format", "csv", "--out", "r.csv"]) == 0
    assert read_csv("r.csv").columns.keys() == read_csv("c/verify.csv").columns.keys()


def test_a_table_with_a_hole_is_refused(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("h.csv").write_text("run,direction,target_mm,measured_mm\n1,+1,0,0\n1,+1,5,5\n2,+1,0,0\n")
    assert main(["records", "export", "h.csv", "--format", "iso-wide", "--out", "w.csv"]) == 2
    assert "h.csv: run 2 lacks target 5 mm" in capsys.readouterr().err


@pytest.mark.outside
def test_an_axis_over_months_and_its_trend(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """E grows by 1 µm in 30 days, on top of the 1.0 of the reversal."""
    start = datetime(2026, 1, 5, 7, 30, tzinfo=UTC)
    for month in range(6):
        measured(place / "X" / f"verify-{month:03d}", 4.0 + month, begun=start + timedelta(days=30 * month))
    argv = ["records", "history", "X", "--figure", "E", "--figure", "B", "--out", "h.html", "--png", "h.png"]
    assert main([*argv, "--json", "h.json"]) == 0
    assert "E: +1.00 ± 0.00 µm (k = 2) in 30 days" in capsys.readouterr().out
    form = json.loads(Path("h.json").read_text())
    assert [moment["E"] for moment in form["moments"]] == pytest.approx([5.0, 6.0, 7.0, 8.0, 9.0, 10.0])
    assert form["per_30_days"]["B"]["slope_um"] == pytest.approx(0.0, abs=1e-6)
    page = Path("h.html").read_text()
    for words in ("2026-01-05 to 2026-06-04", "+1.00 ± 0.00", "clear of its scatter", "verify-003", "<svg"):
        assert words in page
    assert Path("h.png").read_bytes().startswith(b"\x89PNG")
    assert history(find_campaigns(["X"]), ["E"])[0].mean_temp_c == pytest.approx(22.0)


def test_two_axes_are_not_one_history(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    measured(place / "a", 4.0)
    measured(place / "b", 4.0, axis="Y")
    assert main(["records", "history", "."]) == 2
    assert "several axes (X, Y)" in capsys.readouterr().err
    assert main(["records", "history", ".", "--axis", "Y"]) == 0
    assert main(["records", "history", ".", "--axis", "Y", "--pass", "measure"]) == 2


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["list", "nowhere"], "nowhere: is no directory"),
        (["inspect", "."], "holds no campaign"),
        (["merge", "empty.csv", "--out", "o.csv"], "empty.csv: holds no header row"),
    ],
)
def test_what_is_not_there_is_one_line(
    place: Path, argv: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("empty.csv").write_text("")
    assert main(["records", *argv]) == 2
    assert says in capsys.readouterr().err


def test_like_is_compared_with_like(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A calibration's first pass is the uncorrected machine: no part of how the corrected one ages."""
    for number in range(3):
        measured(place / f"verify-{number}", 4.0)
    measured(place / "calibrate-1", 40.0, name="measure")
    assert main(["records", "history", ".", "--figure", "E", "--json", "h.json"]) == 0
    assert "shown: passes named verify; others, for --pass: measure" in capsys.readouterr().out
    assert len(json.loads(Path("h.json").read_text())["moments"]) == 3
    argv = ["records", "history", ".", "--figure", "E", "--pass", "measure", "--pass", "verify", "--json", "h.json"]
    assert main(argv) == 0
    assert len(json.loads(Path("h.json").read_text())["moments"]) == 4


def test_a_trend_needs_three_dates_over_a_day() -> None:
    assert trend(np.array([1.0, 2.0]), np.array([1.0, 2.0])) is None
    assert trend(np.array([1.0, 1.1, 1.2]), np.array([1.0, 2.0, 3.0])) is None
    line = trend(np.array([0.0, 30.0, 60.0, 90.0]), np.array([1.0, 2.0, np.nan, 4.0]))
    assert line is not None
    assert (line.slope_um, line.std_um) == (pytest.approx(1.0), pytest.approx(0.0, abs=1e-9))


@pytest.mark.outside
def test_a_signed_figure_is_drawn_whole(place: Path) -> None:
    from hil.ui.report.history import history_figure  # noqa: PLC0415  (plots are slow to import)
    from hil.ui.report.svg import LIGHT  # noqa: PLC0415

    measured(place / "c", 5.0)
    (moment,) = history(find_campaigns(["."]), ["B_mean"])
    for value, low in ((-3.0, -3.0), (3.0, 0.0)):
        shown = history_figure([replace(moment, figures_um={"B_mean": value})] * 2, ["B_mean"], LIGHT)
        assert shown.axes[0].get_ylim()[0] <= low < value + 0.1 < shown.axes[0].get_ylim()[1] + 0.2
