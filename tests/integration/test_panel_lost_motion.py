"""Lost motion and the circle of two axes on the operator's screen, in a real browser in front of two worn axes on the bench."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import panel
from support.bench_axis import PASSWORDS
from support.panel import Person
from support.two_axes import lay_out_axes

from hil.axis.axis_file import load_axis
from hil.correction.store import SealedStore

pytestmark = panel.MARKS
QUICK = "[lost_motion]\nplaces = 10\nruns = 2\nproof_moves = 6\n"
WORN_UM = 53.0
KEY, READING = PASSWORDS["HIL_KEY_PASSWORD"], PASSWORDS["HIL_PASSWORD"]
ELEMENTS = {
    *(f"lost_motion.{name}" for name in ("instructions", "plan", "position", "remaining", "step", "messages", "start")),
    *(
        f"lost_motion.{name}"
        for name in ("left_over", "store", "amount", "std", "shape", "after", "before", "over", "state")
    ),
    *(f"lost_motion.{name}" for name in ("rise", "beginning", "moves", "rows", "contenders", "fitted")),
    *(f"circle.{name}" for name in ("title", "other", "radius", "feed", "clockwise", "start", "step", "polar", "ring")),
    *("circle.fallen", "circle.bumps", "circle.messages", "stop", "control.who", "header.state"),
}


def is_shown(person: Person) -> None:
    """What was measured, fitted and proven."""
    assert person.waits_for_a_figure("lost_motion.amount") == pytest.approx(WORN_UM, rel=0.01)
    assert 0.0 < person.waits_for_a_figure("lost_motion.std") < 1.0
    assert person.waits_for_a_figure("lost_motion.before") > 10.0
    assert person.waits_for_a_figure("lost_motion.after") < 0.05 * WORN_UM
    assert person.reads("lost_motion.state") == "proven, not stored"
    person.waits(lambda: len(person.table("lost_motion.contenders")) == 5, "five shapes in competition")
    assert sum("(taken)" in row[0] for row in person.table("lost_motion.contenders")) == 1
    assert person.table("lost_motion.fitted")[0][0] == "Amount, µm"
    person.waits(lambda: len(person.drawn("lost_motion.rise")) == 7, "both directions, and five shapes laid over them")
    assert len(person.drawn("lost_motion.beginning")) == 7
    assert person.drawn("lost_motion.moves") == {"without the correction": 7, "with the correction": 7}


def drives_a_circle(person: Person) -> None:
    """Uncorrected, and with the correction of X alone."""
    person.types("circle.radius", "5")
    person.types("circle.feed", "300")
    person.clicks("circle.start")
    asked = person.agrees()
    assert sum("Circle, axis" in line for line in asked) == 2
    person.waits(lambda: "corrected" in person.drawn("circle.polar"), "all circles")
    assert set(person.drawn("circle.polar")) == {"commanded", "uncorrected", "tables alone", "corrected"}
    person.waits(lambda: len(person.table("circle.bumps")) == 3, "the bumps of all")
    before, _, after = ([float(cell) for cell in row[1:5]] for row in person.table("circle.bumps"))
    assert before == pytest.approx([WORN_UM] * 4, rel=0.05)
    assert after[0::2] == pytest.approx([0.0, 0.0], abs=3.0)  # X turns around at 0 and 180°, and is corrected
    assert after[1::2] == pytest.approx([WORN_UM] * 2, rel=0.05)  # Y is not
    assert person.waits_for_a_figure("circle.fallen") == pytest.approx(50.0, abs=3.0)
    assert "neither to half nor to the floor" in person.reads("circle.messages")


def comes_in_control(person: Person, address: str) -> None:
    """Of both axes, on the page of X."""
    person.goes_to(f"{address}axis/Y/lost_motion")
    person.takes_control()
    person.goes_to(f"{address}axis/X/lost_motion")
    person.waits(lambda: person.names() >= ELEMENTS, "every element is there")
    assert not person.finds("lost_motion.start").is_enabled()  # without control nothing starts
    person.takes_control()


def test_from_worn_axes_to_a_correction_in_force_and_a_circle(person: Person, tmp_path: Path) -> None:
    """Stopped in the middle, gone on with after a restart of the server; measured, proven, stored; then a circle with one of two axes
    corrected."""
    paths = lay_out_axes(tmp_path, lost_motion=QUICK)
    rows = tmp_path / "X-campaign" / "lost-motion-001" / "strokes.csv"
    with panel.served(*paths, "--pace", "1") as (address, _):  # it takes minutes, however slow the host is
        comes_in_control(person, address)
        person.clicks("lost_motion.start")
        asked = person.agrees()
        assert any("Strokes to and fro, uncorrected: between 135.413 mm and 141.413 mm" in line for line in asked)
        person.waits(lambda: rows.exists() and len(rows.read_text().splitlines()) > 5, "some rows")
        person.clicks("stop")
        person.waits_to_read("lost_motion.step", "stopped by the operator")
        kept = rows.read_text()
    with panel.served(*paths, "--pace", "0") as (address, _):
        comes_in_control(person, address)
        person.clicks("lost_motion.resume")
        person.agrees()
        person.waits(lambda: panel.figure(person.reads("lost_motion.amount")) is not None, "a figure")
        assert rows.read_text().startswith(kept)
        assert not (tmp_path / "X-campaign" / "lost-motion-002").exists()

        is_shown(person)
        added = rows.read_text().removeprefix(kept).splitlines()
        went_on = sum(not line.startswith("#") for line in added)
        moves = sum(person.drawn("lost_motion.moves").values())
        assert sum(person.drawn("lost_motion.rows").values()) == went_on + moves  # the readings of the job that went on
        assert not person.finds("lost_motion.store").is_enabled()  # without the builder nothing is stored
        person.becomes_builder(KEY, READING)
        person.clicks("lost_motion.store")
        assert any("tables.sealed" in line for line in person.agrees())
        person.waits_to_read("lost_motion.state", "in force")
        assert SealedStore.of(load_axis(paths[0]), READING).load().rise is not None

        drives_a_circle(person)
        person.goes_to(f"{address}axis/Y/lost_motion")
        person.waits(lambda: person.finds("lost_motion.start").is_enabled(), "the other axis is there again")
        person.goes_to(f"{address}axis/Y/probe")
        person.waits(lambda: "start the screen with --probe" in person.reads("probe.none"), "how to name a machine")
