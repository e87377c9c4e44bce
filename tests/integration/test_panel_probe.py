"""The touch probe on the operator's screen, in a real browser in front of the bench."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import panel, probe_files
from support.panel import Person

from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key
from sim_backends.plant.touch_probe import Bore
from sim_backends.probe import known_probe

pytestmark = panel.MARKS
SEED = 4
BENCH = f"[bench]\nseed = {SEED}\n"
FACE = '[face]\naxis = "y"\nx_mm = 20.0\ny_mm = 30.0\ndirection = -1\nsearch_mm = 1.0\n'
TRUTH = known_probe(
    SEED, face_mm=105.0, face_y_mm=40.0, facing=1, tip_radius_mm=2.0, bore_mm=(50.0, 60.0), bore_radius_mm=8.0
)
ELEMENTS = {
    *(f"probe.{name}" for name in ("instructions", "messages", "machine", "mode", "store", "open", "ready", "start")),
    *(f"probe.{name}" for name in ("position", "remaining", "step", "contacts", "closure", "limit", "drawing")),
    *(f"probe.{name}" for name in ("size", "x", "y", "angle", "radius", "std", "verdict")),
    *(f"probe.in_force.{name}" for name in ("x", "y", "angle", "radius")),
    *(f"probe.{name}" for name in ("since", "history", "measurements", "code", "correct", "driven", "counter")),
    *(f"probe.bore.{name}" for name in ("code", "centre", "middle", "diameter", "driven", "counter")),
    *("probe.centre", "stop", "control.who", "header.state"),
}


def comes_to_the_probe(person: Person, address: str) -> None:
    """In control of both axes that the server has of the machine's three; on the page of X."""
    person.goes_to(f"{address}axis/Y/probe")
    person.takes_control()
    person.waits_to_read("probe.ready.other_axes", "Take control of X too")
    assert not person.finds("probe.start").is_enabled()
    person.goes_to(f"{address}axis/X/probe")
    person.waits(lambda: person.names() >= ELEMENTS, "every element is there")
    person.takes_control()


def lay_out_keys(directory: Path) -> None:
    key = new_key()
    save_private_key(directory / "builder.key", key, "builder of the probe", cost=Cost(n=1 << 10, r=8, p=1))
    save_public_key(directory / "builder.pub", key.public_key())


def opens_the_store(person: Person, key_password: str) -> None:
    person.clicks("probe.open")
    person.waits(lambda: person.finds("probe.key_password").is_displayed(), "the passwords are asked for")
    person.finds("probe.reading_password").send_keys("reading of the probe")
    person.finds("probe.key_password").send_keys(key_password)
    person.clicks("probe.open.yes")


def measures(person: Person, ended: str) -> list[str]:
    """M90; what was asked before. ended: what the result is called"""
    count = len(person.table("probe.measurements"))
    person.clicks("probe.start")
    asked = person.agrees()
    person.waits(lambda: len(person.table("probe.measurements")) == count + 1, "it is in the history")
    person.waits_to_read("probe.verdict", ended)
    assert person.table("probe.measurements")[0][-1].startswith(ended)
    return asked


def test_refused_with_a_chip_then_in_force_and_a_bore_centred(tmp_path: Path) -> None:
    given = {
        "start_mm": 102.6,
        "search_mm": 1.0,
        "block": "turns = 2",
        "probe": "touch_mm_s = 20.0\nposition_mm_s = 50.0",
    }
    machine = probe_files.lay_out(tmp_path, more=f"{BENCH}chip_um = 30.0\n", **given)  # type: ignore[arg-type]
    server = (tmp_path / "X.toml", tmp_path / "Y.toml", "--probe", machine, "--pace", "0")
    with panel.browser() as person:
        with panel.served(*server) as (address, _):
            comes_to_the_probe(person, address)
            asked = measures(person, "refused")
            said = "Feeding axis X towards the block until contact, and back: between 102.600 mm and 103.600 mm, at up to 20.0 mm/s."
            assert said in asked
            assert "Spindle orientation, axis S: between 0.000° and 270.000°, at up to 180.0 °/s." in asked
            assert any("runout.json" in line for line in asked)
            assert "the contacts do not close" in person.reads("probe.messages")
            assert abs(person.waits_for_a_figure("probe.closure")) == pytest.approx(30.0, abs=1.0)
            person.waits_to_read("probe.since", "nothing yet")
            assert not person.finds("probe.correct").is_enabled()

        probe_files.lay_out(tmp_path, more=f"{BENCH}[store]\nsealed = true\n{FACE}", **given)  # type: ignore[arg-type]
        lay_out_keys(tmp_path)
        with panel.served(*server) as (address, _):
            comes_to_the_probe(person, address)
            person.waits(lambda: person.table("probe.measurements"), "what was refused is remembered")
            person.waits_to_read("probe.since", "sealed, not opened")
            assert not person.finds("probe.start").is_enabled()
            opens_the_store(person, "wrong")
            person.is_refused("password")
            opens_the_store(person, "builder of the probe")
            person.waits_to_read("probe.store", "Store: opened by the builder")
            for _ in range(2):
                measures(person, "in force")
            is_shown(person)
            centres_a_bore(person)
            measures_a_face(person)
            person.goes_to(
                f"{address}axis/Y/probe"
            )  # one machine, whichever axis's page; but what is sealed was not opened here
            person.waits(lambda: person.reads("probe.bore.centre") != "–", "the centre")
            assert person.reads("probe.store") == "Store: sealed, not opened"


def is_shown(person: Person) -> None:
    """What the simulated machine holds, found by the contacts and in force; and how it came to it."""
    x_um, y_um = (1000.0 * value for value in TRUTH.stylus.offset_mm)
    for name in ("probe", "probe.in_force"):
        assert person.waits_for_a_figure(f"{name}.x") == pytest.approx(x_um, abs=1.0)
        assert person.waits_for_a_figure(f"{name}.y") == pytest.approx(y_um, abs=1.0)
        assert person.waits_for_a_figure(f"{name}.radius") == pytest.approx(TRUTH.stylus.radius_mm, abs=1e-3)
    assert person.waits_for_a_figure("probe.size") == pytest.approx((x_um**2 + y_um**2) ** 0.5, abs=1.0)
    assert 0.0 < person.waits_for_a_figure("probe.std") < 1.0
    rows = person.table("probe.contacts")
    assert [row[:2] for row in rows] == [[turn, f"{angle}°"] for turn in "12" for angle in (0, 90, 180, 270)]
    feeds_mm = [float(row[2]) for row in rows]
    assert feeds_mm[2] - feeds_mm[0] == pytest.approx(2.0 * x_um / 1000.0, abs=2e-3)
    assert [float(row[3]) for row in rows] == pytest.approx([1000.0 * feed_mm for feed_mm in feeds_mm], abs=0.6)
    person.waits(lambda: set(person.drawn("probe.drawing").values()) == {121, 2, 4}, "circle, arrow and contacts")
    person.waits(
        lambda: person.drawn("probe.history") == {"Δx": 2, "Δy": 2, "not put into force": 2}, "three measurements"
    )
    assert [row[-1].split(":")[0] for row in person.table("probe.measurements")] == ["in force", "in force", "refused"]


def pair(text: str) -> tuple[float, float]:
    """Of "X 1.0, Y −2.0"."""
    x, y = text.replace("−", "-").removeprefix("X ").split(", Y ")
    return float(x), float(y)


def measures_a_face(person: Person) -> None:
    """A wall that is met between 4 and 6 tenths of the search; what the run-out makes of it at spindle angle 0."""
    person.clicks("probe.measure_other")
    asked = person.agrees()
    assert (
        "Feeding axis Y towards the work until contact, and back: between 29.000 mm and 30.000 mm, at up to 20.0 mm/s."
        in asked
    )
    person.waits(lambda: person.table("probe.other"), "the face")
    ((what, corrected, uncorrected),) = person.table("probe.other")
    assert what == "Face: place, mm"
    assert 27.4 < float(corrected) < 27.6
    assert float(corrected) - float(uncorrected) == pytest.approx(TRUTH.stylus.offset_mm[1], abs=1e-3)


def centres_a_bore(person: Person) -> None:
    (bore,) = (one for one in TRUTH.solids if isinstance(one, Bore))
    person.clicks("probe.centre")
    asked = person.agrees()
    assert (
        "Feeding axis Y to both sides of the bore until contact: between 52.000 mm and 68.000 mm, at up to 20.0 mm/s."
        in asked
    )
    assert sum("Correction, axis" in line for line in asked) == 2
    person.waits(lambda: person.reads("probe.bore.centre") != "–", "the centre")
    assert pair(person.reads("probe.bore.centre")) == pytest.approx(bore.point_mm[:2], abs=1e-3)
    person.clicks("probe.correct")
    person.agrees()
    person.waits(lambda: person.reads("probe.counter") != "–", "driven")
    assert pair(person.reads("probe.counter")) == pytest.approx((0.0, 0.0), abs=1.0)  # µm: a pulse
