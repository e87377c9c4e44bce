"""The operator's screen in a real browser: calibrate and verify, diagnosis, and reports, each with every element it must have."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.common.by import By
from support import panel
from support.bench_axis import PASSWORDS, lay_out
from support.campaigns import campaign, wavy
from support.panel import Person, figure

from hil.records.rows import read_csv, to_csv

pytestmark = panel.MARKS
READING, KEY = PASSWORDS["HIL_PASSWORD"], PASSWORDS["HIL_KEY_PASSWORD"]
PERIOD_MM, AMPLITUDE_UM = 10.0, 1.2
UNCERTAIN = "\n[uncertainty]\ndevice_um = 0.1\ndevice_um_per_m = 0.5\nvariation_um = 0.4\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An axis with four older campaigns, of which the last holds a cyclic error."""
    directory = tmp_path_factory.mktemp("axis")
    path = lay_out(directory, machine="typical", sections=5, correction="band_um = [2.0, 8.0]")
    path.write_text(path.read_text(encoding="utf-8") + UNCERTAIN, encoding="utf-8")
    for month in (1, 2, 3, 4):
        here = directory / "X-campaign" / f"verify-{month:03d}"
        here.mkdir(parents=True)
        (here / "campaign.json").write_text(json.dumps({"kind": "verify", "axis": "X"}))
        (here / "finished").touch()
        rows = campaign(lambda c, size=month: size * wavy(c), runs=2, targets=6, scatter=0.0, seed=month)
        if month == 4:
            rows = campaign(
                lambda c: wavy(c) + AMPLITUDE_UM * np.sin(2 * np.pi * c["target_mm"] / PERIOD_MM), targets=14
            )
        (here / "verify.csv").write_text(f"# begun 2026-0{month}-11T08:00:00+00:00\n{to_csv(rows)}")
    return directory


@pytest.fixture(scope="module")
def person(folder: Path) -> Iterator[Person]:
    """In control of the axis."""
    with panel.served(folder / "axis.toml", "--pace", "0") as (address, _), panel.browser() as one:
        one.goes_to(f"{address}axis/X/diagnosis")
        one.takes_control()
        yield one


def goes_to(person: Person, page: str) -> None:
    person.goes_to(f"{person.driver.current_url.rpartition('/')[0]}/{page}")


def waits_to_be_drawn(person: Person, name: str) -> dict[str, int]:
    person.waits(lambda: person.drawn(name), f"{name} is drawn")
    return person.drawn(name)


def test_diagnosis_of_a_stored_campaign(person: Person, folder: Path) -> None:
    chosen = "verification · 168 rows"
    person.waits(
        lambda: chosen in person.reads("diagnosis.campaign"), "the newest campaign is chosen, by date and kind"
    )
    person.clicks("diagnosis.start")
    after = person.waits_for_a_figure("diagnosis.after")
    before = person.waits_for_a_figure("diagnosis.before")
    assert after < 0.5 * before
    assert person.reads("diagnosis.found") == "cyclic error"
    assert person.reads("diagnosis.unexplained") == "nothing"
    position = waits_to_be_drawn(person, "diagnosis.residual")
    assert (position["Residual +"], position["Residual −"]) == (84, 84)
    assert position["what the effects found take away +"] >= 84  # at each row, or drawn finer
    assert waits_to_be_drawn(person, "diagnosis.finding.1.curves")["cyclic error +"] == 84
    parameters = {row[0]: figure(row[1]) for row in person.table("diagnosis.finding.1.parameters")}
    assert parameters["Period, mm"] == pytest.approx(PERIOD_MM, abs=0.05)
    assert parameters["Amplitude, µm"] == pytest.approx(AMPLITUDE_UM, abs=0.15)
    parts = {"rivals", "confidence", "explanation", "parameters", "curves"}
    assert {f"diagnosis.finding.1.{part}" for part in parts} <= person.names()
    assert {
        "diagnosis.campaign",
        "diagnosis.peaks",
        "diagnosis.noise",
        "diagnosis.carriers",
        "diagnosis.next_run",
    } <= person.names()
    assert "cosine" in person.reads("diagnosis.blind")
    assert not person.finds("loop.start").is_enabled()  # only the builder may store
    assert {
        "loop.runs",
        "loop.rows",
        "loop.warm_up",
        "loop.feeds",
        "loop.stages",
        "loop.live",
        "loop.step",
    } <= person.names()
    assert (folder / "X-campaign" / "verify-004" / "verify.diagnosis.json").exists()


def test_reports_compared_opened_and_the_history(person: Person) -> None:
    goes_to(person, "reports")
    person.waits(lambda: "2026-01-11" in person.reads("reports.campaigns"), "the campaigns are listed by their dates")
    assert not re.search(r"[a-z]-\d{3}", person.reads("reports.campaigns"))  # and not by their folders
    assert not person.finds("reports.compare").is_enabled()
    boxes = person.driver.find_elements(By.CSS_SELECTOR, "[data-name='reports.campaigns'] tbody .q-checkbox")
    assert len(boxes) == 4
    for box in boxes[2:]:
        box.click()
    person.waits(lambda: person.finds("reports.report").is_enabled(), "a report can be made")
    person.clicks("reports.compare")
    person.waits(lambda: person.finds("reports.open.1").is_displayed(), "the comparison is listed", 120.0)
    history = waits_to_be_drawn(person, "reports.history")
    assert (history["A"], history["A, trend"]) == (3, 2)
    slope = float(person.reads("reports.trend").splitlines()[0].split()[1].replace("+", ""))
    assert slope > 0.0  # each was made worse than the one before
    paper = person.finds("reports.paper.1").get_attribute("href")
    script = "const done = arguments[1]; fetch(arguments[0]).then(r => r.text()).then(t => done(t.slice(0, 5)))"
    assert person.driver.execute_async_script(script, paper) == "%PDF-"
    person.driver.get(person.finds("reports.open.1").get_attribute("href"))
    assert "Comparison of measurements of axis X" in person.driver.page_source
    assert "verify-001/verify" in person.driver.page_source
    person.driver.back()


def test_calibrated_stored_and_verified(person: Person, folder: Path) -> None:
    goes_to(person, "calibrate")
    person.opens("calibrate.plan.lines")
    person.waits(lambda: person.reads("calibrate.plan.lines"), "the plan is shown")
    assert "20.2" in person.reads("calibrate.plan.lines")
    assert not person.finds("calibrate.start").is_enabled()  # an operator's browser
    person.becomes_builder(KEY, READING)
    person.clicks("calibrate.start")
    asked = person.agrees()
    assert any("20 positions" in line or "40 positions" in line for line in asked)
    assert any("tables.sealed" in line for line in asked)
    live = waits_to_be_drawn(person, "calibrate.live")
    assert set(live) <= {
        f"{name}, {way}" for name in ("as found", *(f"with the tables, round {n}" for n in range(1, 5))) for way in "+−"
    }
    person.waits(lambda: person.reads("calibrate.now") not in ("", "–"), "it is calibrated")
    before, after = (float(person.reads(f"calibrate.{name}").split(" ± ")[0]) for name in ("before", "now"))
    assert after < 0.3 * before
    assert person.reads("calibrate.verdict") == "inside"
    assert "10 of 10" in person.reads("calibrate.outside")
    measured = read_csv(folder / "X-campaign" / "calibrate-001" / "measure.csv")
    assert person.drawn("calibrate.live")["as found, +"] == int(np.sum(measured.direction > 0))
    assert waits_to_be_drawn(person, "calibrate.curves")["as found +"] == 5
    assert all(f"{name} " in person.reads("calibrate.figures") for name in "AERM")
    assert person.reads("calibrate.figures").count("±") >= 8

    person.clicks("calibrate.correction")  # off
    person.clicks("calibrate.verify")
    person.agrees()
    person.waits(lambda: "uncorrected +" in person.drawn("calibrate.curves"), "it is measured without correction")
    assert {
        "calibrate.seed",
        "calibrate.open",
        "calibrate.uncertainty",
        "calibrate.verified_band",
        "calibrate.progress",
    } <= person.names()
    assert "calibrate.resume.calibrate" not in person.names()  # nothing was interrupted
    assert {path.name for path in (folder / "X-campaign").glob("*-00[1-9]")} >= {"calibrate-001", "uncorrected-001"}


def test_a_loop_of_before_and_the_diagnosis_in_german(person: Person, folder: Path) -> None:
    if not (folder / "X-campaign" / "verify-004" / "verify.diagnosis.json").exists():  # tests of a file may run apart
        test_diagnosis_of_a_stored_campaign(person, folder)
    here = folder / "X-campaign" / "close-loop-001"
    here.mkdir()
    (here / "campaign.json").write_text(json.dumps({"kind": "close-loop", "axis": "X"}))
    for name, size in (("measure", 3), ("round-1", 1)):
        (here / f"{name}.csv").write_text(to_csv(campaign(lambda c, size=size: size * wavy(c), runs=2, targets=6)))
    goes_to(person, "diagnosis")
    person.chooses("language", "Deutsch")
    person.waits(
        lambda: person.reads("diagnosis.finding.1.explanation").startswith("Die Abweichung wiederholt sich alle"),
        "what was found is said in German",
    )
    assert "Periode, mm" in person.reads("diagnosis.finding.1.parameters")
    assert "Kosinusfehler" in person.reads("diagnosis.blind")
    person.turns_to("diagnosis.tab.loop")
    assert person.reads("loop.of").startswith("Kreis vom 20")
    assert person.reads("loop.verdict") == "nicht zu Ende geführt"
    assert [row.split()[0] for row in person.reads("loop.stages").splitlines()[1:]] == ["unkorrigiert", "Tabellen"]
