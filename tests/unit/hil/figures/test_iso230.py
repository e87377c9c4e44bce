"""ISO 230-2 figures against published values, and against a second implementation written from the standard's text."""

from __future__ import annotations

import random
from statistics import fmean, stdev

import numpy as np
import pytest
from support.places import SHARED_DATA as DATA

from drivers.errors import InputError
from hil.figures import FIGURES
from hil.figures.iso230 import iso230
from hil.records.rows import Records, read_csv

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


SAMPLE_LIN_TARGETS_MM = (
    6.711,
    181.1319,
    355.5528,
    529.9737,
    704.3946,
    878.8155,
    1053.2364,
    1227.6573,
    1402.0782,
    1576.4991,
    1750.92,
)
SAMPLE_LIN = {
    1: (
        (-12, -5, 2, -6, -19, -30, -37, -37, -35, -32, -36),
        (-17, -9, -6, -12, -23, -35, -43, -44, -43, -38, -40),
        (-19, -11, -7, -13, -29, -37, -46, -51, -50, -47, -45),
        (-13, -2, 1, -3, -14, -28, -36, -36, -32, -28, -32),
        (-19, -8, -7, -13, -23, -37, -45, -46, -45, -41, -45),
    ),
    -1: (
        (23, 36, 35, 30, 17, 4, -4, -2, 2, 3, -1),
        (21, 35, 33, 27, 15, 2, -7, -6, -2, -1, -6),
        (19, 31, 30, 24, 10, -2, -10, -10, -10, -9, -12),
        (28, 37, 38, 32, 19, 9, 0, -2, 5, 5, 4),
        (22, 32, 35, 26, 11, -1, -9, -11, -5, -4, -9),
    ),
}
"""Errors in 0.1 µm of five runs in each direction: the numbers of Sample.Lin, which comes with Keysight's E1733A."""


def sample_lin() -> Records:
    return simple(
        [
            (run, way, target, target + tenths * 1e-4)
            for way, runs in SAMPLE_LIN.items()
            for run, errors in enumerate(runs, start=1)
            for target, tenths in zip(SAMPLE_LIN_TARGETS_MM, errors, strict=True)
        ]
    )


def test_published_figures_of_sample_lin() -> None:
    found = iso230(sample_lin())
    figures = found.figures()
    assert {name: f"{figures[name]:.2f}" for name in FIGURES} == PUBLISHED["iso230_example.csv"]
    assert list(figures) == ["A", "A_up", "A_down", "E", "E_up", "E_down", "M", "R", "R_up", "R_down", "B", "B_mean"]
    assert found.mean_up is not None
    assert found.s_up is not None
    # first target forward: -1.2 -1.7 -1.9 -1.3 -1.9, mean -1.6; squares about it .16 .01 .09 .09 .09 = .44; √(.44 / 4)
    assert (found.mean_up[0], found.s_up[0]) == pytest.approx((-1.6, 0.331662), abs=1e-6)
    # and backward 2.3 2.1 1.9 2.8 2.2, mean 2.26; squares about it .0016 .0256 .1296 .2916 .0036 = .452; √(.452 / 4), and 4 of it
    assert found.s_down is not None
    assert found.R_down_i is not None
    assert found.mean is not None
    assert (found.s_down[0], found.R_down_i[0]) == pytest.approx((0.336155, 1.344619), abs=1e-6)
    assert found.mean[0] == pytest.approx(0.33)
    assert [note.split(" (")[0] for note in found.notes] == [
        "targets are evenly spaced"
    ]  # 174.4209 mm each time, and otherwise as the standard wants it


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


@pytest.mark.parametrize("campaigns", [200, pytest.param(1000, marks=pytest.mark.outside)])
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
        ([*GRID, (4, 1, 10.0, 10.0), (4, -1, 10.0, 10.0)], r"target 10 mm has 4 run\(s\) in direction -1, expected 3"),
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


def campaign_over(travel_mm: float, targets: int, runs: int, last_step_mm: float = 13.0) -> Records:
    """Evenly spaced targets but for the last step, which is longer."""
    places = [(travel_mm - last_step_mm) * i / (targets - 1) for i in range(targets - 1)]
    places.append(travel_mm)
    return simple([(run, way, p, p + 1e-3 * run) for run in range(1, runs + 1) for way in (1, -1) for p in places])


@pytest.mark.parametrize(
    ("travel_mm", "targets", "runs", "asked"),
    [
        # up to 2 m: five targets per metre and at least five, five runs
        (300.0, 5, 5, ()),
        (300.0, 4, 5, ("4 targets over 300 mm; the standard asks for at least 5",)),
        (1000.0, 5, 5, ()),
        (1001.0, 5, 5, ("5 targets over 1001 mm; the standard asks for at least 6",)),
        (2000.0, 10, 5, ()),
        (2000.0, 9, 5, ("9 targets over 2000 mm; the standard asks for at least 10",)),
        (300.0, 5, 4, ("4 runs per direction; the standard asks for five on axes up to 2 m",)),
        (2000.0, 10, 4, ("4 runs per direction; the standard asks for five on axes up to 2 m",)),
        # beyond: a mean interval of at most 250 mm, so 2500 mm in ten intervals between eleven targets; one run will do
        (2500.0, 11, 2, ()),
        (2500.0, 10, 2, ("10 targets over 2500 mm; the standard asks for at least 11",)),
        (2501.0, 11, 5, ("11 targets over 2501 mm; the standard asks for at least 12",)),
        (2001.0, 10, 4, ()),
        (2001.0, 9, 4, ("9 targets over 2001 mm; the standard asks for at least 10",)),
    ],
)
def test_what_the_standard_asks_of_a_campaign(
    travel_mm: float, targets: int, runs: int, asked: tuple[str, ...]
) -> None:
    records = campaign_over(travel_mm, targets, runs)
    assert iso230(records).notes == asked
    elsewhere = records.with_column("target_mm", records.target_mm - 700.0)  # wherever the travel begins
    assert iso230(elsewhere).notes == asked


def test_when_targets_count_as_evenly_spaced() -> None:
    """Within a thousandth of the mean interval; two targets have one interval only."""
    for last_step_mm, even in ((0.0, True), (0.095, True), (0.105, False)):
        notes = iso230(campaign_over(500.0, 6, 5, last_step_mm)).notes
        assert any("evenly spaced (100 mm)" in note for note in notes) is even, last_step_mm
    assert not any("evenly" in note for note in iso230(campaign_over(500.0, 2, 5)).notes)
    assert any("evenly spaced (250 mm)" in note for note in iso230(campaign_over(500.0, 3, 5, 0.0)).notes)


def test_the_larger_of_both_repeatabilities_counts() -> None:
    """Forward 0 and 10 µm: s = √50 = 7.0711, 4 s = 28.284; backward 5 and 5: s = 0; B = 0: 2·7.0711 + 0 + 0 = 14.142."""
    rows = [(run, 1, p, p + e) for p in (0.0, 50.0) for run, e in ((1, 0.0), (2, 0.01))]
    rows += [(run, -1, p, p + 0.005) for p in (0.0, 50.0) for run in (1, 2)]
    found = iso230(simple(rows))
    assert found.figures() == pytest.approx(
        {"R_up": 28.284271, "R_down": 0.0, "R": 28.284271, "B": 0.0, "B_mean": 0.0, "M": 0.0}
        | {"E": 0.0, "E_up": 0.0, "E_down": 0.0, "A": 28.284271, "A_up": 28.284271, "A_down": 0.0},
        abs=1e-6,
    )


def test_rows_in_motion_are_counted_whichever_way_they_move() -> None:
    columns = {"velocity_mm_s": [-7.0, 0.5, float("nan")] + [0.0] * 15}
    notes = iso230(simple(GRID, **columns)).notes
    assert any("2 row(s) were captured in motion (up to 7 mm/s)" in note for note in notes)
    assert not any("motion" in note for note in iso230(simple(GRID, velocity_mm_s=[0.0] * 18)).notes)


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
    assert (form["m"], form["n"], form["standard"]) == (3, 3, "ISO 230-2:2014")
    assert {name: value for name, value in targets[2].items() if name != "target_mm"} == pytest.approx(
        {"mean_up_um": 2, "mean_down_um": -2, "s_up_um": 1, "s_down_um": 1}
        | {"B_um": 4, "R_up_um": 4, "R_down_um": 4, "R_um": 8}
    )
    one_way = iso230(simple([row for row in GRID if row[1] == 1])).as_json()["targets"]
    assert isinstance(one_way, list)
    assert (one_way[0]["mean_down_um"], one_way[0]["B_um"], one_way[0]["R_up_um"]) == (None, None, pytest.approx(4))
