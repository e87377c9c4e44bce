"""Drawings: what is drawn is what the figures say."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from hil.correction.tables import Band, SignedSections
from hil.figures.iso230 import Iso230, iso230
from hil.records.rows import Floats, Records
from hil.ui.report.data import NamedCampaign, history
from hil.ui.report.plots import before_after_plot, error_plot, history_plot, residual_plot
from hil.ui.report.svg import LIGHT, file_bytes
from hil.ui.report.views import binned_mean


def rows(seed: int, spread_um: float = 5.0, runs: int = 4) -> Records:
    rng = np.random.default_rng(seed)
    targets = np.sort(rng.uniform(0, 100, 6))
    shape = rng.normal(0, spread_um, 6)
    found = [
        (run, sign, x, x + (shape[i] + sign + rng.normal(0, 0.5)) / 1000, 10.0 * run)
        for run in range(1, runs + 1)
        for sign in (1, -1)
        for i, x in enumerate(targets)
    ]
    names = ("run", "direction", "target_mm", "measured_mm", "temp_nut_c")
    return Records.of(dict(zip(names, zip(*found, strict=True), strict=True)))


def lines(ax: Axes, label: str) -> list[tuple[Floats, Floats]]:
    return [
        (np.asarray(line.get_xdata()), np.asarray(line.get_ydata()))
        for line in ax.get_lines()
        if str(line.get_label()).startswith(label)
    ]


def axes(figure: Figure) -> list[Axes]:
    return list(figure.axes)


def test_the_band_is_drawn_with_the_sign_of_each_section_and_direction() -> None:
    records = rows(1)
    first, last = float(records.target_mm.min()), float(records.target_mm.max())
    middle = (first + last) / 2
    band = Band(6.0, 7.0, (SignedSections(middle, last + 1.0, 1, -1),))
    (ax,) = axes(error_plot(NamedCampaign("a", records), LIGHT, band))
    boxes = [one.get_paths()[0].get_extents() for one in ax.collections if isinstance(one, PolyCollection)]
    drawn = {(one.x0, one.x1, one.y0, one.y1) for one in boxes}
    assert {(first, middle, 6.0, 7.0), (middle, last, 6.0, 7.0), (middle, last, -7.0, -6.0)} <= drawn
    assert (first, middle, -7.0, -6.0) not in drawn
    names = [text.get_text() for legend in ax.figure.legends for text in legend.get_texts()]
    assert {"specified ±(6 to 7) µm", "specified, direction +", "specified, direction −"} <= set(names)


def test_error_plot_draws_every_run_the_means_and_the_accuracy() -> None:
    records = rows(1)
    figures = iso230(records)
    (ax,) = axes(error_plot(NamedCampaign("a", records), LIGHT, Band(-1.0, 1.0)))
    for sign, name, mean in ((1, "+", figures.mean_up), (-1, "−", figures.mean_down)):
        ((x, y),) = lines(ax, f"direction {name}: mean ± 2s")
        assert x == pytest.approx(figures.target_mm)
        assert y == pytest.approx(mean)
        for run in records.runs:
            here = (records.run == run) & (records.direction == sign)
            drawn = [np.asarray(line.get_ydata()) for line in ax.get_lines() if line.get_linewidth() == 0.7]
            assert any(len(y) == 6 and np.allclose(np.sort(y), np.sort(records.error_um[here])) for y in drawn)
    bracket = [text for text in ax.texts if text.get_text().startswith("A\n")]
    assert [text.get_text() for text in bracket] == [f"A\n{figures.A:.2f} µm"]
    dotted = [float(np.asarray(line.get_ydata())[0]) for line in ax.get_lines() if line.get_linewidth() == 0.8]
    assert max(dotted) - min(dotted) == pytest.approx(figures.A)
    assert len(lines(ax, "specified -1 to 1 µm")) == 2


def test_before_and_after_share_their_scale() -> None:
    campaigns = [
        NamedCampaign("before", rows(1, 20.0)),
        NamedCampaign("after", rows(2, 0.5)),
        NamedCampaign("z", rows(3)),
    ]
    drawn = axes(before_after_plot(campaigns, LIGHT))
    assert [ax.get_title(loc="left").split("\n")[0] for ax in drawn] == ["before", "after", "z"]
    assert len({ax.get_ylim() for ax in drawn}) == 1
    low, high = drawn[0].get_ylim()
    worst = campaigns[0].records.error_um
    assert low < worst.min()
    assert high > worst.max()
    figures = campaigns[1].figures()
    assert isinstance(figures, Iso230)
    assert drawn[1].get_title(loc="left").split("\n")[1] == f"A = {figures.A:.2f} µm"


def test_history_plot_has_run_means_and_temperatures() -> None:
    records = rows(1)
    upper, lower = axes(history_plot(NamedCampaign("a", records), LIGHT))
    bars = [y[0] for _, y in lines(upper, "mean of the run")]
    expected = [history(records).deviation_um[records.run == run].mean() for run in records.runs]
    assert bars == pytest.approx(expected)
    ((_, temperature),) = lines(lower, "nut")
    assert temperature == pytest.approx(records["temp_nut_c"])
    assert "no time" in lower.get_xlabel()


def test_an_overlay_is_a_line_where_it_is_a_curve_and_rings_where_not() -> None:
    x = np.tile(np.linspace(0, 10, 30), 2)
    direction = np.repeat([1.0, -1.0], 30)
    noise = np.random.default_rng(0).normal(0, 1, 60)
    curve = np.sin(x / 3) + 0.3 * direction
    (ax,) = axes(residual_plot(x, noise, curve, direction, LIGHT, x_label="x", over="effect"))
    assert sorted(str(line.get_label()) for line in ax.get_lines() if line.get_linewidth() == 2) == [
        "effect, direction +",
        "effect, direction −",
    ]
    same = np.sin(x / 3)
    (ax,) = axes(residual_plot(x, noise, same, direction, LIGHT, x_label="x", over="effect"))
    assert [line.get_label() for line in ax.get_lines() if line.get_linewidth() == 2] == ["effect"]
    rough, ones = np.random.default_rng(0).normal(0, 1, 300), np.ones(300)
    (ax,) = axes(residual_plot(np.arange(300.0), rough, rough, ones, LIGHT, x_label="x", over="effect"))
    assert [line.get_marker() for line in ax.get_lines() if line.get_label() == "effect"] == ["o"]
    many = np.repeat(np.linspace(0, 10, 12), 5)  # several values at each x: no curve although it turns little
    fan = many * np.tile(np.linspace(0, 0.05, 5), 12)
    (ax,) = axes(residual_plot(many, fan, fan, np.ones(60), LIGHT, x_label="x", over="effect"))
    assert [line.get_marker() for line in ax.get_lines() if line.get_label() == "effect"] == ["o"]


def test_binned_mean_keeps_the_mean_and_ties() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 1, 500), rng.normal(0, 1, 500)
    smooth = binned_mean(x, y)
    assert smooth.mean() == pytest.approx(y.mean())
    assert len(np.unique(smooth)) == 24
    tied = np.repeat([1.0, 2.0, 3.0], 10)
    assert binned_mean(tied, np.arange(30.0))[:10] == pytest.approx(4.5)
    assert binned_mean(tied, np.arange(30.0))[-10:] == pytest.approx(24.5)
    assert binned_mean(np.zeros(4), np.arange(4.0)) == pytest.approx(1.5)


def test_labels_in_any_script_are_drawn_without_complaint() -> None:
    campaigns = [NamedCampaign("校正前", rows(1)), NamedCampaign("nach der Prüfung", rows(2))]
    assert file_bytes(before_after_plot(campaigns, LIGHT), "png").startswith(b"\x89PNG")
