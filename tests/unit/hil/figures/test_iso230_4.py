"""ISO 230-4 on drawn circles: values by hand, and the least-squares circle of another implementation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from drivers.errors import InputError
from hil.app.main import main
from hil.figures.iso230_4 import iso230_4, least_squares_circle

ANGLE = np.radians(np.arange(0.0, 360.0, 1.0))


def drawn(
    deviation_um: np.ndarray, radius_mm: float = 100.0, centre: tuple[float, float] = (0.0, 0.0), sense: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """A path with these deviations from the radius at `ANGLE`, driven in the sense."""
    r = radius_mm + deviation_um / 1000.0
    x, y = centre[0] + r * np.cos(ANGLE), centre[1] + r * np.sin(ANGLE)
    return (x, y) if sense > 0 else (x[::-1].copy(), y[::-1].copy())


def test_a_diameter_stated_as_radius_is_refused() -> None:
    with pytest.raises(InputError, match="a radius of 100 mm where 200 mm is stated"):
        iso230_4([drawn(np.zeros(360))], 200.0)


def test_an_ellipse_and_its_opposite_by_hand() -> None:
    """r = R + 3 + 4 cos 2θ counter-clockwise, R - 1 + 4 cos 2θ clockwise, µm."""
    ellipse = 4.0 * np.cos(2 * ANGLE)
    found = iso230_4(
        [drawn(3.0 + ellipse, centre=(7.0, -2.0)), drawn(-1.0 + ellipse, centre=(7.0, -2.0), sense=-1)], 100.0
    )
    ccw, cw = found.paths
    assert (ccw.name, cw.name) == ("ccw", "cw")
    assert ccw.G_um == pytest.approx(8.0, abs=0.01)
    assert cw.G_um == pytest.approx(8.0, abs=0.01)
    assert (ccw.F_max_um, ccw.F_min_um) == pytest.approx((7.0, -1.0), abs=0.02)
    assert (cw.F_max_um, cw.F_min_um) == pytest.approx((3.0, -5.0), abs=0.02)
    assert found.G_b_um == pytest.approx(12.0, abs=0.02)  # from -5 to +7
    assert found.D_um == pytest.approx(1.0, abs=0.02)  # mean of +3 and -1
    assert np.cos(np.radians(ccw.start_deg)) == pytest.approx(1.0)
    assert ccw.end_deg - ccw.start_deg == pytest.approx(359.0, abs=1e-3)
    assert cw.end_deg - cw.start_deg == pytest.approx(-359.0, abs=1e-3)


def test_a_reversal_spike_of_known_height() -> None:
    """A spike of 12 µm within 2° after 90° on a true circle: G is its height, but for what it moves the mean circle by."""
    spike = np.where((np.degrees(ANGLE) >= 90.0) & (np.degrees(ANGLE) < 92.0), 12.0, 0.0)
    found = iso230_4([drawn(spike)], 100.0)
    assert found.paths[0].G_um == pytest.approx(12.0, abs=0.15)
    assert found.G_b_um is None
    assert found.D_um is None


@given(
    centre=st.tuples(st.floats(-500, 500), st.floats(-500, 500)),
    radius=st.floats(1.0, 300.0),
    orders=st.lists(st.tuples(st.integers(2, 9), st.floats(-20, 20), st.floats(0, 6.28)), min_size=0, max_size=4),
    seed=st.integers(0, 1000),
)
@settings(max_examples=40)
def test_the_circle_is_that_of_an_independent_least_squares(
    centre: tuple[float, float], radius: float, orders: list[tuple[int, float, float]], seed: int
) -> None:
    """scipy's trust region over the geometric distances, which knows nothing of Gauss and Newton's step."""
    deviation = sum((a * np.cos(k * ANGLE + p) for k, a, p in orders), np.zeros(len(ANGLE)))
    deviation = deviation + np.random.default_rng(seed).normal(0.0, 0.5, len(ANGLE))
    x, y = drawn(deviation, radius, centre)

    def distances(p: np.ndarray) -> np.ndarray:
        return np.asarray(np.hypot(x - p[0], y - p[1]) - p[2])

    judge = least_squares(distances, [x.mean(), y.mean(), radius], xtol=1e-15, ftol=1e-15, gtol=1e-15)
    ours = least_squares_circle(x, y)
    assert (*ours.centre_mm, ours.radius_mm) == pytest.approx(tuple(judge.x), abs=1e-6)
    about = np.hypot(x - judge.x[0], y - judge.x[1])
    assert iso230_4([(x, y)], radius).paths[0].G_um == pytest.approx(1000.0 * np.ptp(about), abs=2e-3)


def test_both_ways_count_the_same_whatever_their_numbers_of_points() -> None:
    """Four times as many points clockwise: D stays the mean of +3 and -1 µm."""
    x, y = drawn(np.full(len(ANGLE), -1.0), sense=-1)
    fine = np.radians(np.arange(359.75, -0.1, -0.25))
    many = ((100.0 - 0.001) * np.cos(fine), (100.0 - 0.001) * np.sin(fine))
    for back in ((x, y), many):
        assert iso230_4([drawn(np.full(len(ANGLE), 3.0)), back], 100.0).D_um == pytest.approx(1.0, abs=1e-3)


def test_paths_that_are_no_circular_test_are_refused() -> None:
    whole = drawn(np.zeros(len(ANGLE)))
    with pytest.raises(InputError, match=r"covers 180\.0°"):
        iso230_4([(whole[0][:181], whole[1][:181])], 100.0)
    with pytest.raises(InputError, match="10 points"):
        iso230_4([(whole[0][:10], whole[1][:10])], 100.0)
    with pytest.raises(InputError, match="both paths are ccw"):
        iso230_4([whole, whole], 100.0)
    keep = (np.degrees(ANGLE) < 100) | (np.degrees(ANGLE) >= 159.5)
    with pytest.raises(InputError, match="gaps up to 61"):
        iso230_4([(whole[0][keep], whole[1][keep])], 100.0)
    with pytest.raises(InputError, match="on a line"):
        least_squares_circle(np.arange(50.0), 2 * np.arange(50.0))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An ellipse of ±4 µm in every form that the verb reads: points, a telescoping bar's deviations, a result of `hil circle`."""
    monkeypatch.chdir(tmp_path)
    ellipse = 4.0 * np.cos(2 * ANGLE)
    for name, sense in (("ccw", 1), ("cw", -1)):
        x, y = drawn(ellipse + (3.0 if sense > 0 else -1.0), sense=sense)
        Path(f"{name}.csv").write_text(
            "# a test\nx_mm,y_mm\n" + "".join(f"{a},{b}\n" for a, b in zip(x, y, strict=True))
        )
        turn = np.degrees(ANGLE)[::sense]
        bar = (4.0 * np.cos(2 * ANGLE) + (3.0 if sense > 0 else -1.0))[::sense]
        rows = "".join(f"{a},{b},0\n" for a, b in zip(turn, bar, strict=True))
        Path(f"{name}-bar.csv").write_text("angle_deg,deviation_um,extra\n" + rows)
        circle = {"angle_deg": (turn * sense).tolist(), "deviation_um": bar.tolist()}
        Path(f"{name}.json").write_text(
            json.dumps({"radius_mm": 100.0, "sense": sense, "circles": {"uncorrected": circle}})
        )
    return tmp_path


@pytest.mark.parametrize("form", ["{}.csv", "{}-bar.csv", "{}.json"])
def test_the_verb_reads_three_forms_to_the_same_figures(
    place: Path, form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    more = [] if form.endswith("json") else ["--radius", "100"]
    assert main(["iso230-4", form.format("ccw"), form.format("cw"), *more, "--json", "out.json"]) == 0
    found = json.loads(Path("out.json").read_text())["iso230_4"]
    assert (found["G_b_um"], found["D_um"]) == pytest.approx((12.0, 1.0), abs=0.02)
    assert [path["direction"] for path in found["paths"]] == ["ccw", "cw"]
    assert [path["G_um"] for path in found["paths"]] == pytest.approx([8.0, 8.0], abs=0.01)
    assert [path["end_deg"] - path["start_deg"] for path in found["paths"]] == pytest.approx([359.0, -359.0], abs=1e-2)
    assert "G(b)  12.00 µm" in capsys.readouterr().out


def test_the_verb_refuses_what_it_cannot_know(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("torn.csv").write_text("x_mm,y_mm\n1,2\n3\n")
    Path("word.csv").write_text("x_mm,y_mm\n1,two\n")
    Path("head.csv").write_text("a,b\n1,2\n")
    for argv, said in (
        (["ccw.csv"], "state it with --radius"),
        (["ccw.csv", "cw.json", "--radius", "150"], "nominal radii of 100 and 150"),
        (["ccw.json", "ccw.json"], "both paths are ccw"),
        (["ccw.json", "cw.json", "ccw.json"], "3 paths"),
        (["ccw.json", "--circle", "tables"], "holds no circle 'tables', only uncorrected"),
        (["torn.csv", "--radius", "1"], "torn.csv:3: row has 1 columns"),
        (["word.csv", "--radius", "1"], "word.csv:2: y_mm is 'two'"),
        (["head.csv", "--radius", "1"], "head.csv:1: header is a,b"),
    ):
        assert main(["iso230-4", *argv]) == 2
        assert said in capsys.readouterr().err
