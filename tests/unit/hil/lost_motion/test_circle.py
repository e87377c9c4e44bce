"""The circle: its path in time, and the figures of a trace against deviations that were put in."""

from __future__ import annotations

import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from drivers.errors import InputError
from hil.lost_motion.circle.figures import Circle, Trace, by_standard, ring_of, trace_of
from hil.lost_motion.circle.job import AFTER, BEFORE, TABLES, Axes, DrivenCircle
from hil.lost_motion.circle.procedure import CircleRun

CENTRE = (120.0, 80.0)


@pytest.mark.parametrize("sense", [1, -1])
def test_the_path_stays_on_the_circle_at_its_feed_and_turns_once_with_its_arcs(sense: int) -> None:
    circle, period_s = Circle(CENTRE, sense=sense), 0.02
    places = np.array([circle.at(0.0), *(place for place, _ in circle.path(period_s))])
    feeds = np.array([feed for _, feed in circle.path(period_s)])
    x, y = places[:, 0] - CENTRE[0], places[:, 1] - CENTRE[1]
    assert np.hypot(x, y) == pytest.approx(np.full(len(x), 10.0), abs=1e-12)
    speeds = np.hypot(*np.diff(places, axis=0).T) / period_s
    assert speeds.max() <= circle.feed_mm_s * (1 + 1e-6)
    assert np.all(np.abs(np.diff(speeds)) <= circle.ramp_mm_s2 * period_s * 1.01)
    assert np.median(feeds) == pytest.approx(100.0 / 60.0)
    angle = sense * np.degrees(np.unwrap(np.arctan2(y, x)))
    assert np.all(np.diff(angle) > 0.0)
    assert angle[-1] - angle[0] == pytest.approx(420.0, abs=1e-6)
    step = places[1] - places[0]
    assert (np.sign(step[0]), np.sign(step[1])) == circle.starting()


def driven(radius_um: object, circle: Circle, shift_um: tuple[float, float] = (0.0, 0.0)) -> Trace:
    """The trace of positions whose radius is off by a function of the angle along the sense, around a centre that is off."""
    way = np.linspace(0.0, circle.length_mm, 4001)
    angle = np.radians(-90.0) + way / circle.radius_mm
    off_mm = np.array([radius_um(math.degrees(a)) for a in angle]) / 1000.0  # type: ignore[operator]
    u, v = (circle.radius_mm + off_mm) * np.cos(angle), (circle.radius_mm + off_mm) * np.sin(angle)
    return trace_of(CENTRE[0] + u + shift_um[0] / 1000.0, CENTRE[1] + circle.sense * v + shift_um[1] / 1000.0, circle)


@pytest.mark.parametrize("sense", [1, -1])
def test_bumps_come_back_wherever_the_centre_lies(sense: int) -> None:
    heights = {0.0: 12.0, 90.0: -7.0, 180.0: 5.0, 270.0: 3.0}

    def bumpy(angle_deg: float) -> float:
        out = 0.0
        for at, height in heights.items():
            past = (angle_deg - at) % 360.0
            out += height * math.sin(math.pi * past / 8.0) if past < 8.0 else 0.0
        return out

    trace = driven(bumpy, Circle(CENTRE, sense=sense), (40.0, -25.0))
    assert trace.bumps_um == pytest.approx([12.0, 7.0, 5.0, 3.0], abs=0.3)
    assert trace.bump_mean_um == pytest.approx(6.75, abs=0.15)
    assert trace.floor_um < 0.3
    assert trace.roundness_um == pytest.approx(19.0, abs=0.6)


def test_a_step_counts_in_full_and_a_slope_or_an_ellipse_hardly() -> None:
    trace = driven(lambda a: 20.0 if a % 90.0 >= 2.0 else 0.0, Circle(CENTRE))
    assert trace.bump_um(0.0) == pytest.approx(20.0, abs=0.5)
    round_one = driven(lambda a: 2.0 * math.cos(math.radians(2.0 * a)), Circle(CENTRE))
    assert round_one.roundness_um == pytest.approx(4.0, abs=0.01)
    assert max(round_one.bumps_um) < 0.1 * round_one.roundness_um


def test_noise_is_in_the_floor_as_it_is_in_the_bumps() -> None:
    rng = np.random.default_rng(3)
    trace = driven(lambda _a: rng.normal(0.0, 0.1), Circle(CENTRE))
    assert 0.1 < trace.floor_um < 0.6
    assert trace.bump_mean_um == pytest.approx(trace.floor_um, rel=0.4)


@pytest.mark.parametrize("sense", [1, -1])
def test_a_turn_by_the_standard(sense: int) -> None:
    """2 µm out towards the first axis's + direction and 2 µm in on the other side is a shifted centre, which the fit takes; 3 µm all
    round is the radius; 4 µm twice per turn are left."""
    circle = Circle(CENTRE, sense=sense)
    trace = driven(lambda a: 3.0 + 4.0 * math.cos(math.radians(2.0 * a)), circle, (2.0, 0.0))
    (found,) = by_standard(trace, circle).paths
    assert found.sense == sense
    assert (found.G_um, found.F_max_um, found.F_min_um) == pytest.approx((8.0, 7.0, -1.0), abs=0.02)
    assert found.circle.radius_mm == pytest.approx(10.003, abs=1e-5)


def test_rings_of_a_polar_plot() -> None:
    def trace(*deviations_um: float) -> Trace:
        return Trace(np.zeros(len(deviations_um)), np.array(deviations_um))

    assert ring_of([trace(1.0, -7.9), trace(2.0)]) == 2.0
    assert ring_of([trace(8.1)]) == 5.0
    assert ring_of([trace(0.7)]) == 0.2
    assert ring_of([trace(0.0)]) == 0.005
    assert ring_of([]) == 0.5


def test_what_is_no_circle_or_has_no_samples_is_refused() -> None:
    nothing = ({name: 0.0} for name in ("radius_mm", "feed_mm_s", "ramp_mm_s2"))
    for values in (*nothing, {"feed_mm_s": -1.0}, {"sense": 0}):
        with pytest.raises(InputError, match="expected > 0, and 1 or -1"):
            Circle(CENTRE, **values)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="to be reached"):
        Circle(CENTRE, feed_mm_s=50.0)
    # half of the arc before the turn, 5.236/2 mm; 20 mm/s² over it reach √(2·20·2.618) = 10.233 mm/s, 613.99 mm/min
    with pytest.raises(
        InputError, match=r"650 mm/min needs 2\.934 mm .* 2\.618 mm are allowed, .* takes up to 613\.9 mm/min"
    ):
        Circle(CENTRE, feed_mm_s=650.0 / 60.0)
    Circle(CENTRE, feed_mm_s=613.9 / 60.0)
    Circle(CENTRE, radius_mm=0.5, feed_mm_s=0.1, ramp_mm_s2=0.5)
    half = Trace(np.linspace(0.0, 92.5, 500), np.zeros(500))
    with pytest.raises(InputError, match="no samples around 180°"):
        half.bump_um(180.0)


def shaped(bump_um: float, ellipse_um: float) -> Trace:
    """Bumps after each quadrant, and an ellipse: it counts in G and hardly in the bumps."""

    def off_um(angle_deg: float) -> float:
        past = angle_deg % 90.0
        bump = bump_um * math.sin(math.pi * past / 8.0) if past < 8.0 else 0.0
        return bump + ellipse_um * math.cos(2.0 * math.radians(angle_deg))

    return driven(off_um, Circle(CENTRE))


@pytest.mark.parametrize(
    ("tables", "after", "says"),
    [
        ((6.0, 0.5), (1.0, 0.5), "on this circle the lost motion did better"),
        ((1.0, 0.5), (6.0, 0.5), "on this circle the tables alone did better"),
        ((6.0, 0.5), (1.0, 6.0), "neither did better, the bumps are smaller with the lost motion, and G is by tables"),
        ((1.0, 6.0), (6.0, 0.5), "neither did better, the bumps are smaller by tables, and G is with the lost motion"),
        ((3.0, 0.5), (3.0, 9.0), "differ by less than the floor"),
    ],
)
def test_better_is_what_the_bumps_and_the_circular_deviation_both_say(
    tables: tuple[float, float], after: tuple[float, float], says: str
) -> None:
    axes = cast(Axes, tuple(SimpleNamespace(name=name) for name in "XY"))
    runs = {
        name: CircleRun(shaped(*shape), np.zeros(0), np.zeros((0, 2)), 0)
        for name, shape in ((BEFORE, (12.0, 0.5)), (TABLES, tables), (AFTER, after))
    }
    one = DrivenCircle(axes, Circle(CENTRE), runs, Path("circle-001"), by_tables=("Y",))
    assert says in one.comparison
    figures = re.search(r"G (\S+) µm by tables, (\S+) with the lost motion", one.comparison)
    assert (figures is None) == ("floor" in says)
    if figures is not None:
        seen = [float(figure) for figure in figures.groups()]
        assert seen == [round(by_standard(runs[name].trace, one.circle).paths[0].G_um, 2) for name in (TABLES, AFTER)]
    assert one.uncorrected == "axis Y drove by tables alone: no lost motion of it is stored (hil lost-motion)"
