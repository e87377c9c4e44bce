"""What a table leaves between its targets, against closed forms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.bench_axis import lay_out

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.calibration.spacing import Between, between_targets, dense_steps, propose
from hil.records.rows import Floats, Records

PERIOD_MM = 10.0


@pytest.fixture
def axis(tmp_path: Path) -> AxisConfig:
    return load_axis(lay_out(tmp_path, sections=13, correction="accuracy_limit_um = 3.0"))


def measured(axis: AxisConfig, error_um: object, noise_um: float = 0.0) -> Records:
    """The dense pass over an axis of this error."""
    target = np.array([step.target_mm for step in dense_steps(axis)])
    values: Floats = error_um(target)  # type: ignore[operator]
    values = values + np.random.default_rng(1).normal(0.0, noise_um, len(target))
    columns = {"run": np.ones(len(target)), "direction": np.ones(len(target)), "target_mm": target}
    return Records({**columns, "measured_mm": target + values / 1000.0})


def found(axis: AxisConfig, error_um: object, noise_um: float = 0.0) -> Between:
    return between_targets(measured(axis, error_um, noise_um), PERIOD_MM)


def test_a_parabola_leaves_an_eighth_of_its_curvature_times_the_square_of_the_spacing(axis: AxisConfig) -> None:
    curvature = 2.0 * 0.004  # µm/mm²
    fitted = found(axis, lambda x: 0.004 * x**2)
    for spacing in (10.0, 20.0, 40.0):
        expected = fitted.expected(np.arange(20.0, 260.1, spacing).tolist())
        assert expected.E_um == pytest.approx(curvature * spacing**2 / 8.0, rel=0.01)


@pytest.mark.parametrize("amplitude_um", [0.5, 2.0])
def test_a_sine_stays_whole_at_a_spacing_of_its_period_and_goes_below_it(axis: AxisConfig, amplitude_um: float) -> None:
    fitted = found(axis, lambda x: amplitude_um * np.sin(2.0 * np.pi * x / PERIOD_MM))
    assert fitted.amplitude_um == pytest.approx(amplitude_um, rel=1e-3)
    assert fitted.expected(np.arange(20.0, 260.1, PERIOD_MM).tolist()).E_um == pytest.approx(
        2.0 * amplitude_um, rel=0.01
    )
    sag = amplitude_um * (1.0 - np.cos(np.pi / 40.0))  # of a chord over a fortieth of a period, at the crest
    assert fitted.expected(np.arange(20.0, 260.1, PERIOD_MM / 40.0).tolist()).E_um == pytest.approx(2.0 * sag, rel=0.03)


def test_noise_is_told_from_the_cyclic_part_and_counts_in_the_accuracy(axis: AxisConfig) -> None:
    fitted = found(axis, lambda x: 1.5 * np.cos(2.0 * np.pi * x / PERIOD_MM), 0.2)
    assert fitted.scatter_um == pytest.approx(0.2, rel=0.25)
    assert abs(fitted.amplitude_um - 1.5) < 3.0 * fitted.amplitude_std_um
    expected = fitted.expected(axis.measurement.targets_mm)
    assert expected.A_um == pytest.approx(expected.E_um + 4.0 * fitted.scatter_um)


def test_the_proposal_is_fine_enough_for_the_limit_or_says_that_no_table_is(axis: AxisConfig) -> None:
    enough = propose(axis, measured(axis, lambda x: 0.02 * x**2))
    assert enough.now.A_um > 3.0
    assert enough.proposed is not None
    assert enough.proposed.sections > enough.now.sections
    assert enough.proposed.A_um <= 3.0
    assert f"sections = {enough.proposed.sections}" in " ".join(enough.sentences())
    never = propose(axis, measured(axis, lambda x: 0.0 * x, 1.0))
    assert never.proposed is None, "the scatter alone is 4 µm"
    assert "no table" in " ".join(never.sentences())


def test_a_travel_shorter_than_the_dense_stretches_is_refused(tmp_path: Path) -> None:
    path = lay_out(tmp_path, sections=3)
    path.write_text(path.read_text().replace("last_mm = 260.0", "last_mm = 60.0"))
    with pytest.raises(InputError, match=r"span .* expected at least 80 mm"):
        dense_steps(load_axis(path))
