"""A touch probe from a script: the same run-out, centre and files as by the verbs, on the bench."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.probe_files import lay_out

import hil
from hil.app.main import main


def test_the_run_out_is_measured_and_corrects_what_follows(tmp_path: Path) -> None:
    path = lay_out(tmp_path)
    probe = hil.open_probe(path)
    with pytest.raises(hil.InputError, match=r"runout\.json"):
        probe.centre()
    found = probe.measure()
    assert found.good
    assert (found.x_um, found.y_um) == pytest.approx((41.3, -12.7), abs=0.2), "the bench's"
    assert "<html" in found.report(tmp_path / "probe.html").read_text(encoding="utf-8")
    assert len(json.loads(found.save(tmp_path / "probe.json").read_text())["turns"]) == 2
    bore = probe.centre()
    assert bore.diameter_mm == pytest.approx(16.0, abs=0.001)
    assert "<html" in bore.report(tmp_path / "bore.html").read_text(encoding="utf-8")
    moved = probe.correct("M91")
    assert moved.raw.driven_mm == pytest.approx((found.x_um / 1000.0, 0.0))
    with pytest.raises(hil.CapabilityError, match="not certified"):
        moved.certificate(tmp_path / "no.pdf")
    assert main(["probe", "correct", str(path), "--code", "M91", "--json", str(tmp_path / "M91.json")]) == 0
    assert json.loads((tmp_path / "M91.json").read_text()) == moved.form(), (
        "the verb finds what the script put into force"
    )


def test_a_face_is_measured_with_the_run_out_in_force(tmp_path: Path) -> None:
    face = '[face]\naxis = "x"\ndirection = 1\nx_mm = 80.0\ny_mm = 30.0\nsearch_mm = 5.0\n'
    probe = hil.open_probe(lay_out(tmp_path, more=face))
    size_um = abs(probe.measure().x_um)
    found = probe.feature("face")
    (name,) = found.values
    assert abs(found.raw.uncorrected[name] - found.values[name]) * 1000.0 == pytest.approx(size_um, abs=1e-6)
    with pytest.raises(hil.InputError, match=r"lacks the table \[boss\]"):
        probe.feature("boss")


def test_what_is_refused_and_what_is_wrong_says_so(tmp_path: Path) -> None:
    probe = hil.open_probe(lay_out(tmp_path, block="closure_limit_um = 0.0001\n"))
    found = probe.measure()
    assert not found.good
    assert "refused" in found.sentence
    with pytest.raises(hil.InputError, match="expected one of M91, M92, M93"):
        probe.correct("M90")
    with pytest.raises(hil.InputError, match="latch or step"):
        probe.measure(mode="touch")
