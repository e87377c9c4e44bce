"""ISO 230-2 figures against published values, and against a second implementation written from the standard's text."""

from __future__ import annotations

import os
import random
from pathlib import Path
from statistics import fmean, stdev

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError
from hil.iso230 import FIGURES, iso230
from hil.records import Records, read_csv

DATA = Path(os.environ.get("HIL_SHARED_DATA", Path(__file__).resolve().parents[4] / "shared" / "data"))
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA} (set HIL_SHARED_DATA)")

PUBLISHED = {
    "iso230_example.csv": {
        "B": "4.12",
        "B_mean": "-3.71",
        "M": "3.99",
        "E_up": "3.94",
        "E_down": "4.04",
        "E": "7.70",
        "R_up": "2.99",
        "R_down": "2.55",
        "R": "6.55",
        "A_up": "6.14",
        "A_down": "5.77",
        "A": "9.59",
    },
    "stage_b02_x.csv": {"B": "33.58", "M": "93.65", "E": "122.85", "R": "55.16", "A": "135.26"},
}


@needs_data
@pytest.mark.parametrize("name", PUBLISHED)
def test_published_figures_to_the_printed_digit(name: str) -> None:
    figures = iso230(read_csv(DATA / name)).figures()
    assert {key: f"{figures[key]:.2f}" for key in PUBLISHED[name]} == PUBLISHED[name]


def by_the_text(campaign: dict[tuple[float, int], list[float]]) -> dict[str, float]:
    """ISO 230-2:2014 clause 3, sentence by sentence, in plain Python: campaign[P_i, d] = [P_i1, …, P_in] in mm."""
    targets = sorted({target for target, _ in campaign})
    x = {(p, d): [(actual - p) * 1000 for actual in reached] for (p, d), reached in campaign.items()}  # 3.7
    mean_one = {key: fmean(values) for key, values in x.items()}  # 3.9
    mean_two = {p: (mean_one[p, 1] + mean_one[p, -1]) / 2 for p in targets}  # 3.10
    reversal = {p: mean_one[p, 1] - mean_one[p, -1] for p in targets}  # 3.11
    s = {key: stdev(values) for key, values in x.items()}  # 3.14
    repeat_one = {key: 4 * value for key, value in s.items()}  # 3.15
    repeat_two = {
        p: max(2 * s[p, 1] + 2 * s[p, -1] + abs(reversal[p]), repeat_one[p, 1], repeat_one[p, -1]) for p in targets
    }
    up, down = ([mean_one[p, d] for p in targets] for d in (1, -1))
    high = {d: [mean_one[p, d] + 2 * s[p, d] for p in targets] for d in (1, -1)}
    low = {d: [mean_one[p, d] - 2 * s[p, d] for p in targets] for d in (1, -1)}
    return {
        "B": max(abs(value) for value in reversal.values()),  # 3.12
        "B_mean": sum(reversal.values()) / len(targets),  # 3.13
        "R_up": max(repeat_one[p, 1] for p in targets),  # 3.16
        "R_down": max(repeat_one[p, -1] for p in targets),
        "R": max(repeat_two.values()),
        "E_up": max(up) - min(up),  # 3.17
        "E_down": max(down) - min(down),
        "E": max([*up, *down]) - min([*up, *down]),  # 3.18
        "M": max(mean_two.values()) - min(mean_two.values()),  # 3.19
        "A_up": max(high[1]) - min(low[1]),  # 3.20
        "A_down": max(high[-1]) - min(low[-1]),
        "A": max([*high[1], *high[-1]]) - min([*low[1], *low[-1]]),  # 3.21
    }


def random_campaign(rng: random.Random) -> dict[tuple[float, int], list[float]]:
    m, n = rng.randint(2, 14), rng.randint(2, 7)
    targets = sorted(rng.uniform(-800, 1200) for _ in range(m))
    noise_mm, backlash_mm = 10 ** rng.uniform(-5, -2), rng.uniform(-0.05, 0.05) * rng.choice((0, 1))
    scale = [rng.uniform(0.05, 6) for _ in range(2 * m)]
    shape = [rng.gauss(0, 0.02) for _ in range(m)]
    return {
        (p, d): [p + shape[i] + d * backlash_mm / 2 + rng.gauss(0, noise_mm) * scale[2 * i + (d > 0)] for _ in range(n)]
        for i, p in enumerate(targets)
        for d in (1, -1)
    }


def as_records(campaign: dict[tuple[float, int], list[float]], rng: random.Random) -> Records:
    rows = [(run, d, p, actual) for (p, d), reached in campaign.items() for run, actual in enumerate(reached, start=1)]
    rng.shuffle(rows)  # the figures do not hang on the order of the rows
    return Records.of(dict(zip(("run", "direction", "target_mm", "measured_mm"), zip(*rows, strict=True), strict=True)))


@pytest.mark.parametrize("campaigns", [200, pytest.param(1000, marks=pytest.mark.slow)])
def test_agrees_with_the_text_of_the_standard_on_random_campaigns(campaigns: int) -> None:
    rng = random.Random(campaigns)
    for _ in range(campaigns):
        campaign = random_campaign(rng)
        expected = by_the_text(campaign)
        got = iso230(as_records(campaign, rng)).figures()
        assert got.keys() == expected.keys() == FIGURES.keys()
        for name, value in expected.items():
            assert got[name] == pytest.approx(value, rel=1e-9, abs=1e-9), name


def simple(rows: list[tuple[int, int, float, float]], **extra: list[float]) -> Records:
    columns = dict(zip(("run", "direction", "target_mm", "measured_mm"), zip(*rows, strict=True), strict=True))
    return Records.of({**columns, **extra})


GRID = [(run, d, p, p + 0.001 * run * d) for run in (1, 2, 3) for d in (1, -1) for p in (0.0, 10.0, 21.0)]


def test_error_is_measured_minus_target_whatever_was_commanded() -> None:
    plain = iso230(simple(GRID))
    commanded = iso230(simple(GRID, command_mm=[p + 0.5 for _, _, p, _ in GRID]))
    assert commanded.figures() == plain.figures()


def test_a_worked_case_by_hand() -> None:
    # x↑ = 1, 2, 3 µm and x↓ = -1, -2, -3 µm at every target: means ±2, s 1
    figures = iso230(simple(GRID))
    assert (figures.m, figures.n) == (3, 3)
    assert figures.mean_up == pytest.approx([2, 2, 2])
    assert figures.s_down == pytest.approx([1, 1, 1])
    assert figures.B_i == pytest.approx([4, 4, 4])
    assert figures.R_i == pytest.approx([8, 8, 8])
    assert figures.mean == pytest.approx([0, 0, 0], abs=1e-9)
    assert figures.figures() == pytest.approx(
        {"A": 8, "A_up": 4, "A_down": 4, "E": 4, "E_up": 0, "E_down": 0, "M": 0}
        | {"R": 8, "R_up": 4, "R_down": 4, "B": 4, "B_mean": 4},
        abs=1e-8,
    )


@given(shift_um=st.floats(-500, 500), seed=st.integers(0, 10_000))
@settings(max_examples=40, deadline=None)
def test_moving_the_datum_changes_no_range_and_mirroring_swaps_directions(shift_um: float, seed: int) -> None:
    rng = random.Random(seed)
    records = as_records(random_campaign(rng), rng)
    base = iso230(records)
    moved = iso230(records.with_column("measured_mm", records.measured_mm + shift_um / 1000))
    assert moved.figures() == pytest.approx(base.figures(), rel=1e-6, abs=1e-6)
    mirrored = iso230(records.with_column("direction", -records.direction))
    swap = {"_up": "_down", "_down": "_up"}
    for name, value in base.figures().items():
        other = next((name.replace(old, new) for old, new in swap.items() if name.endswith(old)), name)
        if name != "B_mean":
            assert mirrored.figures()[other] == pytest.approx(value), name
    assert base.B_mean is not None
    assert mirrored.B_mean == pytest.approx(-base.B_mean)


def test_one_run_gives_no_repeatability_and_says_so() -> None:
    figures = iso230(simple([row for row in GRID if row[0] == 1]))
    assert (figures.R, figures.R_up, figures.A, figures.A_down, figures.s_up) == (None,) * 5
    assert figures.figures()["B"] == pytest.approx(2)
    assert any("standard deviation is undefined" in note for note in figures.notes)


def test_one_direction_gives_no_reversal_and_says_so() -> None:
    figures = iso230(simple([row for row in GRID if row[1] == -1]))
    assert (figures.B, figures.B_mean, figures.E, figures.A, figures.M, figures.A_up, figures.mean) == (None,) * 7
    assert figures.A_down == pytest.approx(4)
    assert figures.R_down == pytest.approx(4)
    assert any("direction -1 only" in note for note in figures.notes)


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([row for row in GRID if row[2] == 10.0], "1 target"),
        ([row for row in GRID if row[:3] != (2, 1, 10.0)], r"target 10 mm has 2 run\(s\) in direction \+1, expected 3"),
        ([row for row in GRID if row[1:3] != (-1, 10.0)], r"target 10 mm was measured in direction \+1 only"),
        ([*GRID, (2, 1, 10.0, 10.0)], r"run 2 holds target 10 mm in direction \+1 twice"),
    ],
)
def test_campaigns_the_formulas_do_not_fit_are_refused(rows: list[tuple[int, int, float, float]], says: str) -> None:
    with pytest.raises(InputError, match=says):
        iso230(simple(rows))


def test_short_campaigns_are_noted_against_the_standard() -> None:
    notes = "\n".join(iso230(simple(GRID, velocity_mm_s=[0.0] * 17 + [5.0])).notes)
    assert "3 runs per direction" in notes
    assert "3 targets over 21 mm; the standard asks for at least 5" in notes
    assert "1 row(s) were captured in motion (up to 5 mm/s)" in notes
    assert "evenly spaced" not in notes
    even = simple([(r, d, float(p), float(p)) for r in range(1, 6) for d in (1, -1) for p in range(0, 60, 10)])
    assert [note.split(" (")[0] for note in iso230(even).notes] == ["targets are evenly spaced"]


def test_targets_that_differ_by_float_noise_are_one_target() -> None:
    rows = [(run, d, p + run * 1e-12, p) for run, d, p, _ in GRID]
    assert iso230(simple(rows)).m == 3


def test_json_form_is_plain_and_complete() -> None:
    form = iso230(simple(GRID)).as_json()
    assert form["figures_um"] == pytest.approx(iso230(simple(GRID)).figures())
    targets = form["targets"]
    assert isinstance(targets, list)
    assert [target["target_mm"] for target in targets] == [0.0, 10.0, 21.0]
    assert targets[0]["mean_up_um"] == pytest.approx(2)
    assert np.array(targets[0]["B_um"]) == pytest.approx(4)
