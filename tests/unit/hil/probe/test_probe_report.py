"""The probe's report: its figures, its drawings, and nothing from elsewhere."""

from __future__ import annotations

import json
import re

from hil.probe.report import ProbeReport, render_probe
from hil.probe.runout import FourFeeds, RunOut, run_out

TURN = FourFeeds(2.990, 2.980, 3.010, 3.020)
CHIP = FourFeeds(2.990, 2.930, 3.010, 3.020)


def row(x_um: float, verdict: str) -> dict[str, str]:
    return {"turn": "1", "time": "t", "x_um": str(x_um), "y_um": "-20.0", "tip_radius_mm": "2.0", "verdict": verdict}


def test_the_page_shows_run_out_contacts_and_history() -> None:
    history = [row(10.0, "stored"), row(90.0, "refused: <chip>"), {**row(1.0, "stored"), "turn": "2"}]
    page = render_probe(ProbeReport("Probe", run_out(TURN, 5.0), (TURN, TURN), {"closure": 3.0}, "stored", {}, history))
    assert page.count("<svg") == 3
    assert "22.36" in page  # √(10² + 20²) µm
    assert "refused: &lt;chip&gt;" in page
    assert "The latest 2 measurements" in page
    data = re.search(r'id="data-contacts">(.*?)</script>', page)
    assert data is not None
    assert json.loads(data[1])["columns"]["n_180_mm"] == [3.01, 3.01]
    assert page == render_probe(
        ProbeReport("Probe", run_out(TURN, 5.0), (TURN, TURN), {"closure": 3.0}, "stored", {}, history)
    )


def test_a_refusal_stands_on_top_and_a_single_measurement_has_no_history() -> None:
    page = render_probe(
        ProbeReport(
            "Probe", run_out(CHIP, 5.0), (CHIP,), {"closure": 3.0}, "Refused: a chip", {}, [row(10.0, "refused")]
        )
    )
    assert '<p class="callout">Refused: a chip</p>' in page
    assert '<div class="value worse">50.00' in page
    assert "History" not in page


def test_no_run_out_can_be_drawn() -> None:
    assert "<svg" in render_probe(ProbeReport("Probe", RunOut(0.0, 0.0, 2.0)))
