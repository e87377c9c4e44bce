"""System A as a procedure: measure, store, prove, revise what lies outside and only that; broken off anywhere, the same result."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.toy_axis import LIMITS, MEASUREMENT, ToyMachine, Trouble, toy_session

from drivers.drive import DriveState
from drivers.errors import InputError
from hil.axis.axis_file import CorrectionConfig
from hil.calibration.calibrate import Calibration, calibrate
from hil.calibration.verify import verify
from hil.correction.tables import Band, SingleTable, TableMode, TableSet, section_means, straightness_table
from hil.records.journal import Campaign
from hil.records.rows import Records, read_csv

BAND = Band(6.0, 7.0)
PLAIN = CorrectionConfig(TableMode.BIDIRECTIONAL, None, 4, 0.1, 3.0, combined=False, straightness_share=0.0)
SPECIFIED = replace(PLAIN, band=BAND)

# A screw so wavy that its error changes on the way of the correction itself: no table is right at the first attempt.
WAVY = {"wave_um": 5.0, "wave_period_mm": 0.31}


def run(
    machine: ToyMachine,
    directory: Path,
    correction: CorrectionConfig,
    stored: list[TableSet] | None = None,
    *,
    resume: bool = False,
    straightness: SingleTable | None = None,
) -> Calibration:
    campaign = Campaign(directory, {"kind": "calibrate"}, resume=resume)
    with toy_session(machine) as session:
        session.prepare()
        store = (stored if stored is not None else []).append
        return calibrate(session, campaign, correction, store, straightness=straightness)


def sections(records: Records) -> set[tuple[float, int]]:
    return set(zip(records.target_mm.tolist(), (int(sign) for sign in records.direction), strict=True))


def final_errors(result: Calibration) -> dict[tuple[float, int], float]:
    """The mean error of every section and direction, as it was measured last."""
    latest: dict[tuple[float, int], float] = {}
    for one in result.rounds:
        means = section_means(one.records)
        for sign, errors in ((1, means.plus_um), (-1, means.minus_um)):
            for target, error in zip(means.target_mm.tolist(), errors.tolist(), strict=True):
                if not np.isnan(error):
                    latest[target, sign] = error
    return latest


@pytest.mark.parametrize("mode", TableMode)
def test_without_a_band_the_axis_is_made_as_good_as_it_gets_and_proven_once(tmp_path: Path, mode: TableMode) -> None:
    stored: list[TableSet] = []
    result = run(ToyMachine(), tmp_path, replace(PLAIN, mode=mode), stored)
    assert np.max(np.abs(result.before.error_um)) > 20.0
    (proof,) = result.rounds
    assert np.max(np.abs(proof.records.error_um)) < 0.02
    assert sections(proof.records) == {(target, sign) for target in MEASUREMENT.targets_mm for sign in (1, -1)}
    assert result.inside
    assert [tables.digest() for tables in stored] == [result.tables.digest()]
    assert result.tables.mode is mode


def check_specified(result: Calibration, correction: CorrectionConfig) -> None:
    """Inside everywhere; each round after the first measured the sections that were outside before it, and no others."""
    assert result.inside
    errors = final_errors(result)
    assert len(errors) == 2 * len(MEASUREMENT.targets_mm)
    assert all(BAND.low_um <= error <= BAND.high_um for error in errors.values())
    assert len(result.rounds) <= correction.max_rounds
    for earlier, later in zip(result.rounds, result.rounds[1:], strict=False):
        outside = {(section.target_mm, section.direction) for section in earlier.outside}
        assert sections(later.records) == outside
        assert len(later.records) == MEASUREMENT.runs * len(outside)
        for sign in (1, -1):
            at = np.array(MEASUREMENT.targets_mm)
            was, now = earlier.tables.correction_um(at, sign), later.tables.correction_um(at, sign)
            for target, before, after in zip(at.tolist(), was, now, strict=True):
                if (target, sign) not in outside:
                    assert after == pytest.approx(before, abs=1e-9)
                elif earlier is result.rounds[0]:  # the formula
                    error = next(
                        one.error_um for one in earlier.outside if (one.target_mm, one.direction) == (target, sign)
                    )
                    assert after - before == pytest.approx(BAND.middle_um - error, abs=1e-9)
                else:  # fine steps
                    steps = (after - before) / correction.fine_step_um
                    assert steps == pytest.approx(round(steps), abs=1e-6)
                    assert 1 <= abs(round(steps)) <= correction.fine_range_um / correction.fine_step_um


@pytest.mark.parametrize("mode", TableMode)
@pytest.mark.parametrize("seed", range(5))
def test_a_specified_accuracy_is_reached_by_revising_what_lies_outside(
    tmp_path: Path, mode: TableMode, seed: int
) -> None:
    correction = replace(SPECIFIED, mode=mode)
    stored: list[TableSet] = []
    result = run(ToyMachine(**WAVY, noise_um=0.1, seed=seed), tmp_path, correction, stored)
    check_specified(result, correction)
    assert len(result.rounds) > 1, "this screw must need a revision, or the test shows nothing"
    assert [tables.digest() for tables in stored] == [one.tables.digest() for one in result.rounds]


def test_a_section_still_outside_after_the_formula_is_taken_inside_by_fine_steps(tmp_path: Path) -> None:
    """This screw takes up to a third of every correction away or adds it on top, so that the formula misses."""
    correction = replace(SPECIFIED, max_rounds=8)
    result = run(ToyMachine(wave_um=6.0, wave_period_mm=0.11), tmp_path, correction)
    check_specified(result, correction)
    assert len(result.rounds) > 2


@pytest.mark.parametrize(
    "form", [{"combined": True}, {"straightness_share": 0.4}, {"straightness_share": 1.0, "combined": True}]
)
@pytest.mark.parametrize("mode", TableMode)
def test_every_form_of_store_gives_the_same_machine(tmp_path: Path, mode: TableMode, form: dict[str, float]) -> None:
    plain = run(ToyMachine(**WAVY), tmp_path / "plain", replace(SPECIFIED, mode=mode))
    other = run(ToyMachine(**WAVY), tmp_path / "other", replace(SPECIFIED, mode=mode, **form))
    assert other.tables.specified is None
    assert other.inside
    assert len(other.rounds) == len(plain.rounds)
    at = np.linspace(-5, 105, 111)
    for sign in (1, -1):
        assert other.tables.correction_um(at, sign) == pytest.approx(plain.tables.correction_um(at, sign), abs=1e-3)


def test_a_straightness_table_in_the_same_command_is_not_corrected_twice(tmp_path: Path) -> None:
    straightness = straightness_table([0.0, 100.0], [3.0, -8.0])
    result = run(ToyMachine(), tmp_path, PLAIN, straightness=straightness)
    assert result.tables.straightness == straightness
    assert np.max(np.abs(result.rounds[-1].records.error_um)) < 0.02


def test_a_band_narrower_than_the_repeatability_is_refused_before_anything_is_stored(tmp_path: Path) -> None:
    stored: list[TableSet] = []
    with pytest.raises(InputError, match=r"6 to 6\.1 µm is 0\.10 µm wide.*repeatability of 0\.\d\d µm"):
        run(ToyMachine(noise_um=0.15), tmp_path, replace(SPECIFIED, band=Band(6.0, 6.1)), stored)
    assert stored == []
    assert len(read_csv(tmp_path / "measure.csv")) == 2 * MEASUREMENT.runs * len(MEASUREMENT.targets_mm)
    assert not (tmp_path / "round-1.csv").exists()


def test_sections_that_stay_outside_are_named_after_the_last_round(tmp_path: Path) -> None:
    result = run(ToyMachine(**WAVY), tmp_path, replace(SPECIFIED, max_rounds=1))
    assert not result.inside
    assert len(result.rounds) == 1
    assert result.outside
    for section in result.outside:
        assert f"{section.target_mm:g} mm" in str(section)


def test_an_axis_that_is_right_at_once_needs_one_round(tmp_path: Path) -> None:
    result = run(ToyMachine(), tmp_path, SPECIFIED)
    assert len(result.rounds) == 1
    assert result.rounds[0].records.error_um == pytest.approx(np.full(16, 6.5), abs=0.05)


# -- broken off and taken up -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_broken_off_at_random_moments_it_ends_with_the_same_tables(tmp_path: Path, seed: int) -> None:
    correction = replace(SPECIFIED, mode=list(TableMode)[seed % 2])
    whole = run(ToyMachine(**WAVY), tmp_path / "whole", correction)
    generator = random.Random(seed)
    rows: dict[str, list[str]] = {}
    stored: list[TableSet] = []
    attempts = 0
    while True:
        machine = ToyMachine(
            **WAVY, motor_mm=generator.uniform(0, 100), trouble=Trouble(at_call=generator.randint(40, 400))
        )
        attempts += 1
        try:
            result = run(machine, tmp_path / "broken", correction, stored, resume=attempts > 1)
            break
        except KeyboardInterrupt:
            assert machine.state is not DriveState.ENABLED
        for path in (tmp_path / "broken").glob("*.csv"):
            lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
            assert lines[: len(rows.get(path.name, []))] == rows.get(path.name, []), "a row that was there is gone"
            rows[path.name] = lines
        assert LIMITS.travel_min_mm <= machine.lowest_mm
        assert machine.highest_mm <= LIMITS.travel_max_mm
    assert attempts > 3
    check_specified(result, correction)
    assert len(result.rounds) == len(whole.rounds)
    at = np.array(MEASUREMENT.targets_mm)
    for sign in (1, -1):
        assert result.tables.correction_um(at, sign) == pytest.approx(whole.tables.correction_um(at, sign), abs=1e-3)
    assert stored[-1].digest() == result.tables.digest()


def test_taken_up_with_another_straightness_table_its_rounds_are_refused(tmp_path: Path) -> None:
    """The proof on disk was measured with other tables than those that would be computed now."""
    run(ToyMachine(), tmp_path, PLAIN, straightness=straightness_table([0.0, 100.0], [3.0, -8.0]))
    with pytest.raises(InputError, match=r"round-1\.csv:1: was measured for something else"):
        run(ToyMachine(), tmp_path, PLAIN, resume=True)


# -- proving it elsewhere --------------------------------------------------------------------------------------------------------


def test_verification_looks_between_the_sections_and_judges_by_the_band(tmp_path: Path) -> None:
    machine = ToyMachine(wave_period_mm=400.0)
    with toy_session(machine) as session:
        session.prepare()
        campaign = Campaign(tmp_path, {"kind": "test"}, resume=False)
        tables = calibrate(session, campaign, SPECIFIED, [].append).tables
        good = verify(session, campaign, "verify", Band(5.5, 7.5), seed=2)
        bad = verify(session, campaign, "verify-strict", Band(-0.1, 0.1), seed=2)
        unjudged = verify(session, campaign, "verify-free", seed=3)
    assert good.good
    assert unjudged.good
    assert not bad.good
    assert len(bad.outside) == 2 * (len(MEASUREMENT.targets_mm) - 1)
    assert not set(good.records.target_mm) & set(MEASUREMENT.targets_mm)
    assert set(good.records.target_mm) != set(unjudged.records.target_mm)
    assert tables.specified is not None
