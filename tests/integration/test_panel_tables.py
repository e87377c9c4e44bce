"""Typed tables and straightness on the operator's screen in a real browser: refused, asked, stored and in force as at the terminal."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver.common.by import By
from support import bench_axis, panel
from support.bench_axis import PASSWORDS
from support.panel import Person
from support.screenshots import complaints
from support.two_axes import lay_out_bent

from hil.axis.axis_file import load_axis
from hil.correction.store import SealedStore
from hil.correction.tables import SingleTable, TableSet
from hil.records.rows import read_csv

pytestmark = panel.MARKS
READING, KEY = PASSWORDS["HIL_PASSWORD"], PASSWORDS["HIL_KEY_PASSWORD"]
TYPED = "position_mm,plus_um,minus_um\n20,-1,2\n480,3,4\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """X on a bent way, whose store is combined, and Y, which is moved against it."""
    x, _ = lay_out_bent(tmp_path, other="ideal", sections=9)
    x.write_text(x.read_text(encoding="utf-8").replace("[correction]", "[correction]\ncombined = true"))
    return tmp_path


@pytest.fixture
def person(folder: Path) -> Iterator[Person]:
    """In control of both axes, on X's page of calibration."""
    served = panel.served(folder / "X.toml", folder / "Y.toml", "--pace", "0")
    with served as (address, _), panel.browser() as one:
        for axis in "YX":
            one.goes_to(f"{address}axis/{axis}/calibrate")
            one.takes_control()
        yield one


def types(person: Person, name: str, text: str) -> None:
    person.waits(lambda: person.finds(name).is_displayed(), f"{name} is there")
    person.types(name, text)


def opens_what_is_entered(person: Person) -> None:
    more = "[data-name='calibrate.manual.more'] .q-expansion-item__container"
    person.driver.find_element(By.CSS_SELECTOR, more).click()


def stored_parts(person: Person) -> dict[str, str]:
    return {row[0]: row[1] for row in person.table("calibrate.stored")}


def test_typed_and_measured_straightness_stored_by_the_builder_alone(person: Person, folder: Path) -> None:
    axis = load_axis(folder / "X.toml")
    opens_what_is_entered(person)
    types(person, "calibrate.manual.table", TYPED)
    assert not person.finds("calibrate.manual.store").is_enabled()  # an operator's browser
    assert not person.finds("calibrate.straighten").is_enabled()
    assert "combined" in person.reads("calibrate.manual.form")

    person.becomes_builder(KEY, READING)
    types(person, "calibrate.manual.table", "position_mm,plus_um,minus_um\n20,-1,2\n480,3,many\n")
    person.clicks("calibrate.manual.store")
    person.is_refused("minus_um")  # with file and line
    types(person, "calibrate.manual.table", "position_mm,plus_um,minus_um\n20,-1,2\n480,3,900\n")
    person.clicks("calibrate.manual.store")
    person.is_refused("max_correction_um")
    assert not axis.tables_path.exists()

    types(person, "calibrate.manual.table", TYPED)
    person.clicks("calibrate.manual.store")
    asked = person.agrees()
    assert "Pitch +: – → −1.00 to 3.00 µm (2 places)" in asked
    assert any("tables.sealed" in line for line in asked)
    expected = {"Pitch +": "−1.00 to 3.00 µm (2 places)", "Pitch −": "2.00 to 4.00 µm (2 places)"}
    person.waits(lambda: stored_parts(person) == expected, "what is stored is shown")
    assert SealedStore.of(axis, READING).load().tables.pitch.plus_um.tolist() == [-1.0, 3.0]

    types(person, "calibrate.manual.table", TYPED.replace("480,3", "480,5"))
    person.clicks("calibrate.manual.store")
    assert "Pitch +: −1.00 to 3.00 µm (2 places) → −1.00 to 5.00 µm (2 places)" in person.agrees()
    person.waits(lambda: "5.00" in stored_parts(person)["Pitch +"], "the new ones are shown")

    person.clicks("calibrate.straighten")
    asked = person.agrees()
    assert any("Axis Y" in line and "200.000 mm" in line for line in asked)
    person.waits(lambda: "→" in person.reads("calibrate.straight"), "it is measured and proven")
    before, after = (float(one.split(" ± ")[0]) for one in person.reads("calibrate.straight").split(" → "))
    assert after < 0.4 * before  # 9 places, straight between them
    person.waits(lambda: "Straightness, other axis" in stored_parts(person), "it is stored")
    stored = SealedStore.of(axis, READING).load()
    assert stored.moves_axis == "Y"
    assert stored.tables.pitch.plus_um.tolist() == [-1.0, 5.0]

    person.clicks("calibrate.verify")
    assert any("Axis Y" in line for line in person.agrees())
    person.waits(lambda: "verified +" in person.drawn("calibrate.curves"), "it is verified, with Y moved")
    elements = [
        name
        for name in person.names()
        if name.startswith(("calibrate.manual", "calibrate.stored", "calibrate.straight"))
    ]
    assert not complaints(person, elements)


SIGNED = "band_um = [2.0, 11.0]\nsigns = [{ from_mm = 0.0, to_mm = 150.0, plus = 1, minus = -1 }]"


def test_signs_a_backlash_by_other_means_and_taking_the_tables_out_of_force(  # noqa: PLR0915  one person's way
    tmp_path: Path,
) -> None:
    axis = load_axis(bench_axis.lay_out(tmp_path, correction=SIGNED))
    neighbour = SealedStore.of(axis, READING, KEY)
    neighbour = SealedStore(axis.tables_path, "Z", READING, neighbour.builder_public, neighbour.builder_key)
    neighbour.save_tables(TableSet.zero(np.array([0.0, 10.0])))
    with panel.served(axis.path, "--pace", "0") as (address, _), panel.browser() as person:
        person.goes_to(f"{address}axis/X/calibrate")
        person.takes_control()
        person.waits(lambda: "0.0 … 150.0 mm +/−; elsewhere +/+" in person.reads("calibrate.signs"), "the file's signs")
        assert "axis file" not in person.reads("calibrate.signs")
        opens_what_is_entered(person)
        person.becomes_builder(KEY, READING)  # although the file holds nothing of this axis
        assert not any(person.finds(f"calibrate.manual.{name}").is_enabled() for name in ("enter", "withdraw"))
        types(person, "calibrate.manual.signs", "from_mm,to_mm,plus,minus\n150,400,-1,2\n")
        person.waits(lambda: "expected 1 or -1" in person.reads("calibrate.signs"), "a wrong sign is told")
        person.clicks("calibrate.start")
        person.is_refused("expected 1 or -1")
        types(person, "calibrate.manual.signs", "from_mm,to_mm,plus,minus\n150,400,-1,1\n")
        person.waits(lambda: "150.0 … 400.0 mm −/+" in person.reads("calibrate.signs"), "the entered signs")
        assert "Of the axis file: 0.0 … 150.0 mm +/−" in person.reads("calibrate.signs")
        types(person, "calibrate.manual.backlash", "position_mm,backlash_um\n31.5,6\n120.25,6\n244.75,6\n")

        person.clicks("calibrate.start")
        asked = " ".join(person.agrees())
        assert "150 … 400 mm: −/+" in asked
        assert "6.00 to 6.00 µm, 3 places" in asked
        person.waits(lambda: person.reads("calibrate.verdict") == "inside", "inside the band with its signs")
        purpose = json.loads((axis.store.directory / "calibrate-001" / "campaign.json").read_text(encoding="utf-8"))
        signs = {"from_mm": 150.0, "to_mm": 400.0, "plus": -1, "minus": 1}
        assert purpose["correction"]["band"]["signs"] == [signs]
        assert purpose["backlash"]["position_mm"] == [31.5, 120.25, 244.75]
        rows = read_csv(axis.store.directory / "calibrate-001" / "round-1.csv")
        for target, way, error in zip(rows.target_mm, rows.direction, rows.error_um, strict=True):
            assert (-1 if target >= 150.0 and way > 0 else 1) * error == pytest.approx(6.5, abs=0.6)
        colours = "return getElement(Number(arguments[0].id.slice(1))).chart.getOption().series[0].markArea.data"
        areas = person.driver.execute_script(colours, person.finds("calibrate.curves"))
        assert {(one[0]["yAxis"], one[1]["yAxis"]) for one in areas} == {(2, 11), (-11, -2)}

        person.clicks("calibrate.verify")
        person.agrees()
        person.waits(lambda: person.reads("calibrate.not_judged"), "what lies between two signs is named")
        assert person.reads("calibrate.not_judged").count(" mm +") == 1
        assert "−" not in person.reads("calibrate.not_judged")
        assert person.reads("calibrate.verified_band") == "inside"

        types(person, "calibrate.manual.backlash", "position_mm,backlash_um\n0,4\n")
        person.clicks("calibrate.manual.enter")
        assert any(line.startswith("Pitch −: ") and "→" in line for line in person.agrees())
        store = SealedStore.of(axis, READING)
        person.waits(lambda: store.load().tables.backlash == SingleTable(np.array([0.0]), np.array([4.0])), "entered")
        person.waits(lambda: person.finds("calibrate.manual.withdraw").is_enabled(), "it is over")
        elements = [name for name in person.names() if name.startswith(("calibrate.manual", "calibrate.signs"))]
        assert not complaints(person, elements)

        person.clicks("calibrate.manual.withdraw")
        asked = " ".join(person.agrees())
        assert "Other axes keep theirs" in asked
        assert "Pitch +: " in asked
        assert asked.count("→ –") == 4
        person.waits(lambda: store.stored() is None, "nothing of the axis is stored")
        person.waits(lambda: not stored_parts(person), "nothing is shown as stored")
        assert not person.finds("calibrate.manual.withdraw").is_enabled()
        assert neighbour.stored() is not None
