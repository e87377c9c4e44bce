"""`hil fleet` over campaigns that the program made itself and over simulated fleets: exit status, output, JSON and pages."""

from __future__ import annotations

import itertools
import json
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from hostile import disks
from support import backlash_axis, bench_axis
from support.fleet import rows, write_campaign
from support.two_axes import lay_out_axes

from hil.app.main import main
from hil.fleet.index import read_table

BEGUN = datetime(2025, 1, 6, 8, tzinfo=UTC)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten axes, measured in 40 weeks; the backlash of one grows by 3 % a week from the 20th on."""
    root = tmp_path_factory.mktemp("fleet")
    rng = np.random.default_rng(1)
    for axis in range(10):
        for week in range(40):
            backlash_um = 10.0 * 1.03 ** max(0, week - 20 if axis == 3 else 0) + rng.normal(0.0, 0.2)
            text = rows(rng, backlash_um, targets=5, runs=3)
            write_campaign(
                root / f"A{axis}-campaign" / f"verify-{week + 1:03d}", f"A{axis}", BEGUN + timedelta(weeks=week), text
            )
    (root / "A9-campaign" / "verify-001" / "campaign.json").write_text("{")
    return root


@pytest.mark.outside
def test_index_trend_compare_diagnose(fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "out.json")
    assert main(["fleet", "trend", str(fleet)]) == 2
    assert "hil fleet index" in capsys.readouterr().err

    assert main(["fleet", "index", str(fleet), "--processes", "1", "--json", out]) == 1
    shown = capsys.readouterr().out
    assert "400: 400 read" in shown
    assert re.search(r"A9-campaign/verify-001: campaign\.json is not JSON", shown)
    made = json.loads(Path(out).read_text())
    assert [one["campaign"] for one in made["unread"]] == ["A9-campaign/verify-001"]
    assert made["rows"] == 399 * 30

    page = tmp_path / "page.html"
    assert main(["fleet", "trend", str(fleet), "--out", str(page), "--json", out, "--false-alarms", "0.1"]) == 1
    streams = capsys.readouterr()
    assert streams.err == "hil: not read: 1 campaigns or passes; hil fleet index lists them\n"
    found = json.loads(Path(out).read_text())
    assert [(one["axis"], one["quantity"]) for one in found["series"] if one["alarm"]] in (
        [("A3", "backlash_um"), ("A3", "A_um")],
        [("A3", "A_um"), ("A3", "backlash_um")],
    )
    assert found["not_read"] == [
        "A9-campaign/verify-001: campaign.json is not JSON, expected what the campaign was started for"
    ]
    html = page.read_text()
    assert html.count("<svg") == 2
    assert "campaign.json is not JSON" in html
    assert "<script src" not in html

    assert main(["fleet", "compare", str(fleet), "--quantity", "backlash_um", "--out", str(page), "--json", out]) == 1
    (compared,) = json.loads(Path(out).read_text())["compared"]
    assert [one["axis"] for one in compared["axes"] if one["unlike"]] == ["A3"]
    assert page.read_text().count("<svg") == 1

    words = ["fleet", "diagnose", str(fleet), "--axis", "A1", "--axis", "A2", "--processes", "1", "--json", out]
    assert main([*words, "--out", str(page)]) == 0
    causes = json.loads(Path(out).read_text())
    assert causes["axes"] == 2
    assert {one["campaign"] for one in causes["causes"]} == {"A1-campaign/verify-040", "A2-campaign/verify-040"}
    assert not any(one["why"] for one in causes["causes"])
    assert len(list((fleet / "fleet-index" / "diagnoses").iterdir())) == 2
    assert main([*words[:4], "nobody"]) == 2

    assert main(["fleet", "trend", str(fleet), "--since", "someday"]) == 2
    assert main(["fleet", "trend", str(fleet), "--quantity", "wear"]) == 2
    assert main(["fleet", "index", str(tmp_path / "nowhere")]) == 2
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.usefixtures("passwords")
@pytest.mark.outside
def test_campaigns_of_the_program_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Calibration, lost motion by the instrument and by torque, each below a directory of its own, as three machines."""
    for place in "abc":
        (tmp_path / place).mkdir()
    bench_axis.lay_out(tmp_path / "a", machine="worn")
    lay_out_axes(tmp_path / "b", "canopen", lost_motion="")
    backlash_axis.lay_out(tmp_path / "c")
    out = tmp_path / "out.json"
    main(["calibrate", str(tmp_path / "a" / "axis.toml")])
    (x,) = (tmp_path / "b").glob("[xX]*.toml")
    assert main(["lost-motion", str(x), "--only-measure", "--json", str(out)]) in (0, 1)
    lost_um = json.loads(out.read_text())["amount_um"]
    (torque,) = (tmp_path / "c").glob("*.toml")
    assert main(["backlash", str(torque), "--json", str(out)]) == 0
    by_torque = json.loads(out.read_text())["fitted"]
    capsys.readouterr()
    assert main(["fleet", "index", str(tmp_path), "--processes", "1"]) == 0, capsys.readouterr()
    found = read_table(tmp_path / "fleet-index", "results").to_pylist()
    values = {(one["campaign"].split("/")[0], one["quantity"]): one for one in found}
    assert {"backlash_um", "A_um"} <= {quantity for place, quantity in values if place == "a"}
    lost = values["b", "lost_motion_um"]
    assert (lost["value"], lost["axis"]) == (pytest.approx(lost_um), "b/X")
    assert lost["std"] > 0.0
    by_fleet = values["c", "torque_lost_motion_um"]
    assert by_fleet["value"] == pytest.approx(by_torque["mean_um"])
    assert 1.96 * by_fleet["std"] == pytest.approx(by_torque["u95_um"], rel=1e-3)
    assert by_fleet["axis"] == "c/X"
    assert values["c", "friction_torque_percent"]["value"] > 1.0
    assert main(["fleet", "trend", str(tmp_path)]) == 0
    assert "not watched:" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["new file", "flush"])
def test_a_disk_that_is_full_at_any_file_of_the_index(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng = np.random.default_rng(2)
    for number in (1, 2):
        write_campaign(tmp_path / "A-campaign" / f"verify-{number:03d}", "A", BEGUN, rows(rng, 9.0, targets=5, runs=3))
    order = ["fleet", "index", str(tmp_path), "--processes", "1"]
    for at in itertools.count(1):
        with disks.FullDisk(kind, at).here():
            status = main(order)
        if status == 0:
            break
        streams = capsys.readouterr()
        assert status == 2
        assert streams.err.count("\n") == 1
        assert "No space left on device" in streams.err
        assert not list(tmp_path.rglob("*.part"))
    assert at > 1
    assert main(order) == 0
    assert read_table(tmp_path / "fleet-index", "rows").num_rows == 2 * 30
