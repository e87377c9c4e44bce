"""Calibration to a specified accuracy on the bench, over the virtual CAN bus and the laser's terminal; and killed as it goes."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis

from hil.axis.axis_file import AxisConfig, load_axis
from hil.calibration.calibrate import Calibration, calibrate
from hil.correction.compensation import Compensation
from hil.correction.sealed import load_public_key
from hil.correction.store import SealedStore
from hil.correction.tables import section_means
from hil.machine.bench_wiring import running_bench
from hil.machine.wiring import connected
from hil.records.journal import Campaign, check_rows
from hil.records.rows import Records, read_csv
from sim_backends.bench import BenchParameters
from sim_backends.interferometer import LaserParameters
from sim_backends.plant.hysteresis import Backlash
from sim_backends.plant.parameters import PlantParameters
from sim_backends.plant.screw import typical_screw
from sim_backends.plant.thermal import ThermalParameters

pytestmark = pytest.mark.outside

LOW_UM, HIGH_UM = 6.0, 7.0
RUNS = 5
SECTIONS = 9
STD_UM = 0.15
KILLS = 8
SAMPLES = 15  # of a reading: 0.3 s at 50 Hz


def bench(seed: int, *, heats_up: bool) -> BenchParameters:
    """±20 µm of pitch and lead error, 12 µm of backlash, readings that repeat within 0.15 µm (one standard deviation).

    heats_up: the screw grows under the measurement itself, so that tables made from the first pass no longer fit at its far end.
    """
    thermal = ThermalParameters(heating_k_per_mm=1.0e-4, expansion_ppm_per_k=11.5) if heats_up else ThermalParameters()
    plant = PlantParameters(
        seed=seed,
        screw=typical_screw(random.Random(seed).getrandbits(32), 500.0, pitch_peak_um=20.0),
        backlash=Backlash(12.0),
        thermal=thermal,
    )
    return BenchParameters(plant=plant, laser=LaserParameters(noise_um=STD_UM * SAMPLES**0.5, seed=seed))


def axis_file(directory: Path, mode: str) -> AxisConfig:
    correction = f'mode = "{mode}"\nband_um = [{LOW_UM}, {HIGH_UM}]'
    return load_axis(bench_axis.lay_out(directory, sections=SECTIONS, runs=RUNS, correction=correction))


def sections(records: Records) -> set[tuple[float, int]]:
    return set(zip(records.target_mm.tolist(), (int(sign) for sign in records.direction), strict=True))


def means(records: Records) -> dict[tuple[float, int], float]:
    """Mean error of each section and direction that was measured, µm."""
    return {
        (target, sign): float(np.mean(records.error_um[(records.target_mm == target) & (records.direction == sign)]))
        for target, sign in sections(records)
    }


@pytest.mark.parametrize(
    ("seed", "mode", "heats_up"),
    [
        (1, "bidirectional", False),
        (2, "bidirectional", True),
        (4, "unidirectional+backlash", True),
    ],
)
def test_every_section_and_direction_ends_inside_the_band(tmp_path: Path, mode: str, seed: int, heats_up: bool) -> None:
    axis = axis_file(tmp_path, mode)
    with running_bench([axis], [bench(seed, heats_up=heats_up)]) as running, connected(axis, running) as machine:
        machine.session.prepare()
        campaign = Campaign(tmp_path / "campaign", axis.purpose("calibrate"), resume=False)
        result = calibrate(machine.session, campaign, axis.correction, lambda tables: None)
        judge(result, tmp_path / "campaign", heats_up=heats_up)


def judge(result: Calibration, directory: Path, *, heats_up: bool) -> None:
    before = section_means(result.before)
    assert np.ptp(result.before.error_um) > 20.0
    assert before.pooled_std_um == pytest.approx(STD_UM, rel=0.35 if not heats_up else 1.0)

    rounds = [read_csv(directory / f"round-{number}.csv") for number in range(1, len(result.rounds) + 1)]
    assert len(rounds) <= 4
    assert len(rounds) > 1 or not heats_up, "without a revision this would say nothing about revising"
    assert not (directory / f"round-{len(rounds) + 1}.csv").exists()
    everything = {(target, sign) for target in before.target_mm.tolist() for sign in (1, -1)}
    assert sections(rounds[0]) == everything
    for earlier, later in pairwise(rounds):
        outside = {where for where, error in means(earlier).items() if not LOW_UM <= error <= HIGH_UM}
        assert sections(later) == outside, "the sections outside, and no others, are measured again"
        assert len(later) == RUNS * len(outside)
    last = {where: error for one in rounds for where, error in means(one).items()}
    assert set(last) == everything
    assert all(LOW_UM <= error <= HIGH_UM for error in last.values()), last
    assert result.inside


# -- kill -9 ---------------------------------------------------------------------------------------------------------------


def rows_of(directory: Path) -> dict[str, list[str]]:
    """The confirmed rows of every pass on disk: those that are in the campaign's chain."""
    found = {}
    for path in sorted(directory.glob("X-campaign/calibrate-*/*.csv")):
        chained = check_rows(path.parent)
        assert chained is not None
        lines = path.read_bytes().decode("utf-8", "replace").split("\n")[: chained.lines.get(path.name, 0)]
        found[path.name] = [line for line in lines if line and not line.startswith("#")]
    return found


def check_nothing_lost(before: dict[str, list[str]], after: dict[str, list[str]]) -> None:
    for name, lines in before.items():
        assert after[name][: len(lines)] == lines, f"{name}: a row that was there is gone"


def sealed_store(directory: Path) -> SealedStore:
    public = load_public_key(directory / "builder.pub")
    return SealedStore(directory / "X-campaign/tables.sealed", "X", bench_axis.PASSWORDS["HIL_PASSWORD"], public)


def progress(directory: Path) -> tuple[int, int]:
    """Bytes of rows, and of whatever else has been written (markers, tables and those being written)."""
    sizes = dict.fromkeys(directory.glob("X-campaign/**/*"), 0)
    for path in sizes:
        with contextlib.suppress(FileNotFoundError):
            sizes[path] = path.stat().st_size if path.is_file() else 1
    rows = sum(size for path, size in sizes.items() if path.suffix == ".csv")
    return rows, sum(sizes.values()) - rows


@contextlib.contextmanager
def calibrating(axis: Path, *more: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "hil.app", "calibrate", str(axis), "--resume", *more]
    environment = {**os.environ, **bench_axis.PASSWORDS}
    with subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def kill_after(
    process: subprocess.Popen[str],
    happened: Callable[[], bool],
    delay_s: float,
    number: signal.Signals = signal.SIGKILL,
) -> str:
    """Send a signal (kill -9) a while after something happened; the wait is for another process's real work."""
    deadline = time.monotonic() + 60.0
    while not happened():
        assert process.poll() is None, f"ended by itself with {process.returncode}: {process.communicate()[1]}"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    time.sleep(delay_s)
    process.send_signal(number)
    return process.communicate()[1]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_asked_to_end_it_says_so_in_one_line_keeps_its_rows_and_names_the_way_on(
    tmp_path: Path, number: signal.Signals
) -> None:
    """Ctrl-C, a service that is stopped, a terminal that is closed: the session is left in order (and with it the axis). The last line
    is the command that goes on."""
    axis = bench_axis.lay_out(tmp_path, sections=25, runs=50)
    with calibrating(axis) as process:
        error = kill_after(process, lambda: progress(tmp_path)[0] > 1000, 0.0, number)
        assert process.returncode == 130
        said, how = error.splitlines()
        assert said == "hil: interrupted; the axis was stopped, what was measured is kept"
        assert how == f"hil: go on with: hil calibrate {axis} --resume"
    rows = rows_of(tmp_path)["measure.csv"]
    assert len(rows) > 5
    assert not (tmp_path / "X-campaign/tables.sealed").exists()


def test_killed_again_and_again_it_resumes_to_the_end_and_loses_nothing(tmp_path: Path) -> None:
    correction = f'mode = "bidirectional"\nband_um = [{LOW_UM}, {HIGH_UM}]'
    axis = bench_axis.lay_out(tmp_path, machine="typical", sections=9, runs=6, correction=correction)
    generator = random.Random("bidirectional")
    kept: dict[str, list[str]] = {}
    stored: set[str] = set()
    kills_with_tables = 0
    for attempt in range(KILLS):
        with calibrating(axis) as process:
            begun = progress(tmp_path)
            if attempt == KILLS - 1:  # how far the kills before let it come is the host's matter

                def happened() -> bool:
                    return (tmp_path / "X-campaign/tables.sealed").exists()
            elif attempt % 4 == 3:  # while something else than rows is being written: the marker, or tables

                def happened(begun: tuple[int, int] = begun) -> bool:
                    rows, other = progress(tmp_path)
                    return other != begun[1] or rows > begun[0] + 700
            else:
                more = generator.randint(0, 16) * 90

                def happened(begun: tuple[int, int] = begun, more: int = more) -> bool:
                    return progress(tmp_path)[0] > begun[0] + more

            kill_after(process, happened, generator.uniform(0.0, 0.05))
        after = rows_of(tmp_path)
        check_nothing_lost(kept, after)
        kept = after
        if (tmp_path / "X-campaign/tables.sealed").exists():
            kills_with_tables += 1
            loaded = sealed_store(tmp_path).load()  # raises unless it is whole and signed
            assert isinstance(loaded, Compensation)
            stored.add(loaded.tables.digest())
    assert kills_with_tables > 0, "none of the kills came after tables had been stored"

    with calibrating(axis, "--json", str(tmp_path / "result.json")) as process:
        _, error = process.communicate(timeout=300)
        assert process.returncode == 0, error
    after = rows_of(tmp_path)
    check_nothing_lost(kept, after)
    result = json.loads((tmp_path / "result.json").read_text(encoding="utf-8"))
    assert result["inside"] is True
    assert sealed_store(tmp_path).load().tables.to_dict() == result["tables"]
    assert len(list(tmp_path.glob("X-campaign/calibrate-*"))) == 1, "one campaign, however often it was interrupted"
    plan = [(run, sign) for run in range(1, 7) for sign in (1, -1)]
    for name in ("measure.csv", "round-1.csv"):
        records = read_csv(next(tmp_path.glob(f"X-campaign/calibrate-*/{name}")))
        expected = [(run, sign, target) for run, sign in plan for target in sorted(set(records.target_mm))[::sign]]
        found = zip(records.run.tolist(), records.direction.tolist(), records.target_mm.tolist(), strict=True)
        assert list(found) == expected, "every planned row once, in its order"
        assert len(expected) == 108
        assert np.all(np.diff(records["time_s"]) > 0)
