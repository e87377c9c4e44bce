"""Latencies that were put into simulated instruments' links are found, and what they did to positions in motion is gone.

The truth is in `sim_backends`: a queue before the terminal, and the plant; the estimate sees bytes and the drive's answers.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis

from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.calibration.in_motion import measure_in_motion, plan_passes
from hil.calibration.latency import dated, measure_latency
from hil.figures.latency import Latency
from hil.machine.bench_wiring import bench_parameters, running_bench
from hil.machine.in_motion_settings import InMotion
from hil.machine.machine import Machine
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from hil.records.rows import Records, read_csv
from sim_backends.gauge import GaugeParameters

pytestmark = pytest.mark.outside

HOW = InMotion((30.0, 110.0), runs=2, stretch_mm=60.0, period_s=0.008)
NOISE_UM = 0.05
UMD = "place_temps = { screw = 4 }"
ND2XX = 'kind = "nd2xx"'
PULSED = 'kind = "nd2xx"\npulsed = true'
COUNTER = 'kind = "ascii"\npattern = "mitutoyo"\ndecimals = 4'


@contextmanager
def machine(
    tmp_path: Path, instrument: str, *, latency_s: float, jitter_s: float = 0.0, face: str = "virtual"
) -> Iterator[Machine]:
    path = bench_axis.lay_out(tmp_path, machine="ideal")
    text = path.read_text().replace("last_mm = 260.0", "last_mm = 480.0").replace(UMD, instrument)
    path.write_text(text.replace("[drive]", f'[drive]\nface = "{face}"'))
    axis = load_axis(path)
    bench = bench_parameters(axis)
    gauge = None
    if "kind" in instrument:
        gauge = GaugeParameters(noise_um=NOISE_UM, latency_s=latency_s, jitter_s=jitter_s)
    laser = replace(bench.laser, noise_um=NOISE_UM, latency_s=latency_s, jitter_s=jitter_s)
    wanted = replace(bench, laser=laser, gauge=gauge)
    with running_bench([axis], [wanted]) as running, connected(axis, running) as found:
        found.session.prepare()
        yield found


@dataclass(frozen=True)
class Found:
    latency: Latency
    before_um: float
    after_um: float
    at_rest_um: float


def found_on(machine: Machine, directory: Path, how: InMotion) -> Found:
    """The latency, and how far readings in motion are from the drive's position without and with it; beside the noise at rest."""
    session = machine.session
    campaign = Campaign(directory, {}, resume=False)
    latency = measure_latency(session, campaign, how)
    one = replace(how, runs=1)
    before = measure_in_motion(session, campaign, "before", plan_passes(session, one, 8), how=one)
    taken_off = replace(one, latency_s=latency.latency_s, dated_by=latency.describe())
    after = measure_in_motion(session, campaign, "after", plan_passes(session, one, 9), how=taken_off)
    at_rest = [session.read_position() for _ in range(6)]
    session.watch(1.0)
    noise = float(np.sqrt(np.mean([reading.std_um**2 for reading in at_rest])))
    return Found(latency, apart_um(before), apart_um(after), noise)


def apart_um(records: Records) -> float:
    return float(np.std(records.measured_mm - records["motor_mm"])) * 1000.0


def check(found: Found, true_s: float, *, within_s: float) -> None:
    print(f"{found.latency.describe()}: true {1e3 * true_s:.3f} ms; {found}")
    assert abs(found.latency.latency_s - true_s) <= found.latency.within_s
    assert found.latency.within_s <= within_s
    assert found.after_um <= 2.0 * found.at_rest_um


def test_a_latency_is_found_on_the_fly_and_taken_off(tmp_path: Path) -> None:
    with machine(tmp_path, UMD, latency_s=0.02) as bench:
        found = found_on(bench, tmp_path / "rows", HOW)
    check(found, 0.02, within_s=2e-5)
    assert found.before_um > 1000.0, "20 ms at 110 mm/s are 2.2 mm"
    head = (tmp_path / "rows" / "after.csv").read_text().split("\n")
    assert any(line.startswith("# dated by latency 20.00") and "±" in line for line in head), (
        "rows say how they were dated"
    )


def test_edges_that_both_see_need_no_even_link_and_tell_the_machine_from_it(tmp_path: Path) -> None:
    with machine(tmp_path, f"trigger_input = 1\n{UMD}", latency_s=0.05, jitter_s=0.003) as bench:
        assert bench.bench is not None
        found = found_on(bench, tmp_path / "rows", replace(HOW, trigger_input=1))
        check(found, 0.0515, within_s=5e-4)  # on average half of the jitter comes on top
        bench.bench.switch_on("velocity_lag", 20.0)  # µm at 100 mm/s: 0.2 ms
        campaign = Campaign(tmp_path / "lag", {}, resume=False)
        lagging = measure_latency(bench.session, campaign, replace(HOW, trigger_input=1))
    assert found.before_um < 2.0 * found.at_rest_um, "an edge dates its row, whatever the latency is"
    assert abs(lagging.latency_s - 0.0515) <= lagging.within_s
    assert lagging.lag_s == pytest.approx(0.0002, rel=0.1)
    assert "delay_s" in read_csv(tmp_path / "lag" / "latency.csv").columns


@pytest.mark.parametrize(
    ("latency_s", "edges"), [(0.0, False), (0.003, False), (0.12, False), (0.0, True), (0.12, True)]
)
def test_short_and_long_latencies(tmp_path: Path, latency_s: float, edges: bool) -> None:
    instrument = f"trigger_input = 2\n{UMD}" if edges else UMD
    with machine(tmp_path, instrument, latency_s=latency_s) as bench:
        how = replace(HOW, trigger_input=2 if edges else None)
        check(found_on(bench, tmp_path / "rows", how), latency_s, within_s=2e-5)


def test_edges_over_canopen(tmp_path: Path) -> None:
    with machine(tmp_path, f"trigger_input = 1\n{UMD}", latency_s=0.02, face="canopen") as bench:
        check(found_on(bench, tmp_path / "rows", replace(HOW, trigger_input=1)), 0.02, within_s=2e-5)


def test_over_modbus_the_age_of_the_drives_answer_counts_as_well(tmp_path: Path) -> None:
    with machine(tmp_path, f"trigger_input = 1\n{UMD}", latency_s=0.02, face="modbus-rtu") as bench:
        found = found_on(bench, tmp_path / "rows", replace(HOW, trigger_input=1, period_s=0.016))
    answer_s = 0.02 - found.latency.latency_s
    assert 0.0 < answer_s < 0.006, (
        "a position was true some time before its message was here: the reading is that less late"
    )
    assert found.after_um <= 2.0 * found.at_rest_um


@pytest.mark.parametrize(
    ("instrument", "true_s"),
    [
        (ND2XX, -0.001),  # it stores its value a millisecond after it was asked, whenever the answer comes
        (COUNTER, 0.02),
        (f"trigger_input = 1\n{COUNTER}", 0.02),
        (f"trigger_input = 1\n{PULSED}", 0.04),  # the display takes 20 ms, the link as long
    ],
    ids=["asked", "by itself", "by itself, edges", "pulsed, edges"],
)
def test_displays(tmp_path: Path, instrument: str, true_s: float) -> None:
    with machine(tmp_path, instrument, latency_s=0.02) as bench:
        how = replace(HOW, trigger_input=1 if "trigger" in instrument else None)
        check(found_on(bench, tmp_path / "rows", how), true_s, within_s=2e-5)


def test_an_uneven_link_on_the_fly_is_as_uncertain_as_is_said(tmp_path: Path) -> None:
    with machine(tmp_path, UMD, latency_s=0.02, jitter_s=0.001) as bench:
        latency = measure_latency(bench.session, Campaign(tmp_path / "rows", {}, resume=False), replace(HOW, runs=4))
    print(latency.describe())
    assert abs(latency.latency_s - 0.0205) <= latency.within_s <= 2e-4


@pytest.mark.parametrize(("stated_s", "status"), [(None, 0), (0.01, 1)])
def test_doctor_measures_it_or_holds_what_is_stated_against_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], stated_s: float | None, status: int
) -> None:
    path = bench_axis.lay_out(tmp_path, machine="ideal")
    stated = "" if stated_s is None else f"latency_s = {stated_s}"
    text = path.read_text().replace("[drive]", '[drive]\nface = "virtual"').replace(UMD, f"{UMD}\n{stated}")
    path.write_text(text.replace("last_mm = 260.0", "last_mm = 480.0"))
    asked = ["doctor", str(path), "--latency", "30,110", "--stretch", "60", "--period", "0.008"]
    assert main([*asked, "--json", str(tmp_path / "d.json")]) == status
    (check,) = [
        check for check in json.loads((tmp_path / "d.json").read_text())["checks"] if check["name"] == "latency"
    ]
    assert check["good"] == (status == 0)
    assert ("for the axis file" in check["detail"]) == (stated_s is None)
    assert "a lag of the table behind its motor would be in it" in check["detail"]
    capsys.readouterr()
    assert main(["doctor", str(path), "--latency", "60,70"]) == 2
    assert "cannot tell a latency from lost motion" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("found", "captured_at"),
    [
        (Latency(0.02, 3e-6, at_edges=False), None),
        (Latency(0.02, 3e-6, at_edges=True), None),
        (Latency(0.02, 3e-4, at_edges=True), 1),
    ],
)
def test_rows_are_captured_at_edges_where_the_link_is_uneven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, found: Latency, captured_at: int | None
) -> None:
    monkeypatch.setattr("hil.calibration.latency.measure_latency", lambda *_: found)
    with connected(load_axis(bench_axis.lay_out(tmp_path))) as bench:
        asked = replace(HOW, trigger_input=1, latency_s=None)
        how, told = dated(bench.session, Campaign(tmp_path / "rows", {}, resume=False), asked)
    assert (how.trigger_input, how.latency_s, told) == (captured_at, 0.02, found)
    assert found.describe() in how.dated_by
    assert how.period_s == (0.01 if captured_at else HOW.period_s)
