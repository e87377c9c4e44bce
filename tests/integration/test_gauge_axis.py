"""A whole job with a display instead of the laser: the bench's axis, verified over a pseudo-terminal."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from support.bench_axis import lay_out

from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.machine.measure import bidirectional_steps, measure
from hil.machine.wiring import connected
from hil.records.journal import Campaign


@pytest.mark.parametrize(
    "section", ['kind = "nd2xx"', 'kind = "ascii"\npattern = "mitutoyo"\ndecimals = 4'], ids=["nd2xx", "mitutoyo"]
)
def test_an_axis_is_measured_with_a_gauge(tmp_path: Path, section: str) -> None:
    path = lay_out(tmp_path, machine="geometric", sections=3, runs=1)
    text = path.read_text().replace("place_temps = { screw = 4 }", section)
    path.write_text(text.replace('backend = "bench"', 'backend = "bench"\nface = "virtual"'))
    axis = load_axis(path)
    true_mm: list[float] = []
    with connected(axis) as machine:
        bench = machine.bench
        assert bench is not None
        campaign = Campaign.numbered(axis.store.directory, axis.purpose("verify"), resume=False)
        machine.session.prepare()
        steps = bidirectional_steps(axis.measurement.targets_mm, 1)
        records = measure(machine.session, campaign, "verify", steps, lambda _: true_mm.append(bench.plant.position_mm))
    assert len(records) == 6
    assert np.ptp(records.error_um) > 3.0, "the machine's own error shows"
    off_um = (records.measured_mm - np.array(true_mm[1:])) * 1000.0  # the first event came before the first row
    assert np.ptp(off_um) < 0.3, "but for the datum the gauge's rows are the truth"


def test_sim_shows_a_display_by_itself(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", "laser", "--kind", "nd2xx", "--for", "0.1"]) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[0])["laser"]["kind"] == "nd2xx"
