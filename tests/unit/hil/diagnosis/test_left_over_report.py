"""What a model leaves, drawn: the means, their bands and the spectrum say what is in the rows, and no more."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
import pytest

from hil.diagnosis.report.diagnosis import section
from hil.diagnosis.report.left_over import mean_curve, panels, panels_plot, read, spectrum, spectrum_plot
from hil.ui.report.blocks import Block, DataTable, Drawing, Paragraph, walk
from hil.ui.report.svg import LIGHT, fresh

N = 240


def rows(seed: int = 0, travel_mm: float = 20.0, **more: np.ndarray) -> dict[str, np.ndarray]:
    """A short travel, which few periods go into: a spectrum is quick."""
    rng = np.random.default_rng(seed)
    return {
        "run": np.repeat(np.arange(1.0, 7.0), N // 6),
        "target_mm": np.round(rng.uniform(0.0, travel_mm, N), 3),
        "direction": np.tile([1.0, -1.0], N // 2),
        "time_s": np.arange(N) * 6.0,
        **more,
    }


def diagnosis(left_um: np.ndarray, columns: dict[str, np.ndarray], *carriers: list[str], **more: Any) -> dict[str, Any]:
    plain = {name: values.tolist() for name, values in columns.items()}
    return {
        "findings": [],
        "unexplained": bool(carriers),
        "carried_by": [{"columns": names, "rms_um": 1.234, "rms_std_um": 0.056} for names in carriers],
        "left": {"every": 1, "left_um": left_um.tolist(), "columns": plain},
        **more,
    }


def names(blocks: list[Block]) -> list[str]:
    return [block.file for block in walk(blocks) if isinstance(block, Drawing)]


# means


def test_a_mean_curve_holds_every_row_once_and_its_band_the_truth() -> None:
    rng = np.random.default_rng(1)
    inside, bins = 0, 0
    for _ in range(40):
        x = rng.uniform(-1.0, 1.0, 200)
        y = 2.0 * x + rng.normal(0.0, 0.5, 200)
        curve = mean_curve("a", x, y)
        assert np.sum(curve.rows) == 200
        assert np.all(np.diff(curve.at) > 0)
        assert np.sum(curve.rows * curve.mean_um) == pytest.approx(np.sum(y))
        inside += int(np.sum((curve.low_um <= 2.0 * curve.at) & (2.0 * curve.at <= curve.high_um)))
        bins += len(curve.at)
    assert 0.93 < inside / bins < 0.97


def test_levels_are_kept_apart_and_a_single_row_has_no_band() -> None:
    x = np.concatenate([np.repeat([10.0, 50.0, 100.0], 20) * np.tile([0.99, 1.01], 30), [75.0]])
    curve = mean_curve("feeds", x, x / 10.0)
    assert curve.levels
    assert curve.at == pytest.approx([10.0, 50.0, 75.0, 100.0])
    assert np.isnan(curve.low_um).tolist() == [False, False, True, False]
    assert not mean_curve("all over", np.linspace(0, 1, 61), x).levels


# spectrum


def test_a_sine_at_uneven_targets_is_found_with_its_amplitude() -> None:
    columns = rows(2, 100.0)
    noise = np.random.default_rng(3).normal(0.0, 0.3, N)
    seen = spectrum(
        columns["target_mm"], 0.4 * np.sin(2 * np.pi * columns["target_mm"] / 7.3 + 1.0) + noise, columns["run"]
    )
    assert seen is not None
    period, amplitude = seen.highest
    assert period == pytest.approx(7.3, abs=0.1)
    assert amplitude == pytest.approx(0.4, abs=0.08)
    assert amplitude > 1.5 * seen.level_um


def test_amplitudes_are_those_of_a_least_squares_fit() -> None:
    columns = rows(4)
    y = np.random.default_rng(5).normal(size=N) + np.cos(columns["target_mm"] / 1.7)
    seen = spectrum(columns["target_mm"], y, columns["run"])
    assert seen is not None
    for line in range(0, len(seen.period_mm), 9):
        angle = 2 * np.pi * columns["target_mm"] / seen.period_mm[line]
        fit, *_ = np.linalg.lstsq(np.column_stack([np.ones(N), np.sin(angle), np.cos(angle)]), y, rcond=None)
        assert seen.amplitude_um[line] == pytest.approx(np.hypot(*fit[1:]), rel=1e-3, abs=1e-5)


def test_noise_alone_exceeds_the_level_in_5_of_100_cases_whatever_its_runs() -> None:
    """Runs of different noise; few lines, so that many campaigns can be asked."""
    rng = np.random.default_rng(6)
    run = np.repeat([1.0, 2.0, 3.0], 20)
    above = 0
    for seed in range(100):
        seen = spectrum(rng.uniform(0.0, 12.0, 60), run * rng.normal(size=60), run, seed)
        assert seen is not None
        above += seen.highest[1] > seen.level_um
    assert 1 <= above <= 11


def test_nothing_is_said_between_targets_that_repeat() -> None:
    target = np.tile(np.linspace(0.0, 400.0, 21), 10)
    seen = spectrum(target, np.random.default_rng(7).normal(size=210), np.repeat(np.arange(10.0), 21))
    assert seen is not None
    assert np.min(seen.period_mm) >= 40.0 * 0.99
    assert spectrum(np.full(20, 5.0), np.arange(20.0), np.ones(20)) is None
    assert spectrum(np.arange(4.0), np.arange(4.0), np.ones(4)) is None


# the part of the report


def test_columns_that_carry_together_are_split_by_each_other() -> None:
    rng = np.random.default_rng(8)
    a, b = rng.normal(size=N), rng.normal(size=N)
    columns = rows(coolant_l_min=a, load_kg=b)
    found = read(diagnosis(a * b, columns, ["coolant_l_min", "load_kg"]))
    assert found is not None
    drawn = {panel.label: panel for panel in panels(found)}
    assert list(drawn) == ["Target, mm", "Direction", "Time, s", "Coolant l min", "Load, kg"]
    low, high = drawn["Load, kg"].curves
    assert low.label.startswith("coolant l min up to")
    assert (low.mean_um[0] > low.high_um[-1], high.mean_um[0] < high.low_um[-1]) == (True, True)
    assert [curve.label for curve in drawn["Target, mm"].curves] == ["direction +", "direction −"]
    assert len(drawn["Time, s"].curves) == 1


def test_a_position_that_carries_together_with_a_column_is_split_by_both() -> None:
    columns = rows(air_humidity_percent=np.random.default_rng(9).normal(50.0, 5.0, N))
    found = read(diagnosis(np.ones(N), columns, ["air_humidity_percent", "target_mm"]))
    assert found is not None
    labels = [[curve.label for curve in panel.curves] for panel in panels(found) if panel.label == "Target, mm"]
    assert labels[0] == ["direction +", "direction −"]
    assert labels[1][0].startswith("air humidity up to")


def test_it_is_drawn_where_something_is_unexplained_and_elsewhere_when_asked() -> None:
    left = np.random.default_rng(10).normal(size=N)
    clean = diagnosis(left, rows())
    assert names(section(clean, None)) == []
    assert names(section(clean, None, all_plots=True)) == ["left-over", "spectrum"]
    blocks = section(diagnosis(left, rows(), ["time_s"]), None)
    assert names(blocks) == ["left-over", "spectrum"]
    tables = {block.identifier: block.columns for block in walk(blocks) if isinstance(block, DataTable)}
    assert tables["data-left-over"]["left_um"] == pytest.approx(left)
    assert np.sum(tables["data-left-over-means"]["rows"]) == 3 * N, "each row in each of three drawings"
    assert set(tables["data-spectrum"]) == {"period_mm", "amplitude_um"}
    words = " ".join(block.text for block in walk(blocks) if isinstance(block, Paragraph))
    assert "It shows along: time_s (1.23 ± 0.11 µm RMS, k = 2). Nothing was compensated for it." in words


def test_where_a_table_at_just_these_targets_took_it_all_there_is_no_spectrum() -> None:
    columns = rows(target_mm=np.tile(np.linspace(0.0, 400.0, 12), 20))
    left = np.random.default_rng(12).normal(size=N)
    for target in np.unique(columns["target_mm"]):
        here = columns["target_mm"] == target
        left[here] -= np.mean(left[here])
    blocks = section(diagnosis(left, columns, ["time_s"]), None)
    assert names(blocks) == ["left-over"]
    words = " ".join(block.text for block in walk(blocks) if isinstance(block, Paragraph))
    assert "there is no spectrum to draw" in words


def test_a_correction_without_a_cause_is_said_to_be_one() -> None:
    asked = diagnosis(np.ones(N), rows(), ["time_s"], non_parametric=[{"explanation": "The cause is unknown: 0.3 µm."}])
    words = " ".join(block.text for block in walk(section(asked, None)) if isinstance(block, Paragraph))
    assert "because that was asked for: The cause is unknown: 0.3 µm." in words
    assert "Nothing was compensated" not in words


@pytest.mark.parametrize(
    "left",
    [
        None,
        [],
        {},
        {"left_um": "x", "columns": {}},
        {"left_um": [1.0, 2.0], "columns": {"run": [1, 1], "direction": [1, 1], "target_mm": [1.0]}},
        {"left_um": [1.0, None], "columns": {"run": [1, 1], "direction": [1, 1], "target_mm": [1.0, 2.0]}},
    ],
)
def test_what_cannot_be_drawn_is_left_out(left: object) -> None:
    assert names(section({"findings": [], "unexplained": True, "left": left}, None)) == []


def test_rows_of_one_place_in_one_direction_make_a_drawing_too() -> None:
    columns = {"run": np.ones(3), "direction": np.ones(3), "target_mm": np.full(3, 7.0), "time_s": np.arange(3.0)}
    assert names(section(diagnosis(np.arange(3.0), columns, ["time_s"]), None)) == ["left-over"]


def test_the_drawings_hold_what_the_tables_hold() -> None:
    columns = rows()
    left = np.random.default_rng(11).normal(size=N)
    found = read(diagnosis(left, columns, ["time_s"]))
    assert found is not None
    shown = panels(found)
    with mpl.rc_context():
        drawn = [ax for ax in panels_plot(shown, LIGHT, fresh).axes if ax.axison]
    assert [ax.get_xlabel() for ax in drawn] == [panel.label for panel in shown]
    lines = [line for line in drawn[2].get_lines() if line.get_label() == "all rows"]
    assert np.asarray(lines[0].get_ydata()) == pytest.approx(shown[2].curves[0].mean_um)
    seen = spectrum(columns["target_mm"], left, columns["run"])
    assert seen is not None
    (ax,) = spectrum_plot(seen, LIGHT, fresh).axes
    assert np.asarray(ax.get_lines()[0].get_ydata()) == pytest.approx(seen.amplitude_um)
    assert np.asarray(ax.get_lines()[1].get_ydata())[0] == pytest.approx(seen.level_um)
