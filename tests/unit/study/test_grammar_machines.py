"""The machines of the grammar study are what they claim to be, and know nothing of what they judge."""

import ast
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from study.grammar import campaign, environment, equivalence, noise, outside, physics, report
from study.grammar.machine import LOTS, SEEDS, STRONG, WEAK, draw
from study.grammar.reference import Reference, outside_um
from study.grammar.twins import DISTANCE, twin
from support.catalogue import NAMES

TESTS = Path(__file__).resolve().parents[2]
GENERATOR = ("campaign", "environment", "noise", "physics", "outside", "reference", "twins", "machine")
FIRST = SEEDS["tuning"][0]


@pytest.fixture(scope="module")
def state():
    rng = np.random.default_rng(5)
    axis = campaign.draw_axis(rng)
    moves = campaign.plan(rng, axis, "mixed", campaign.Variation(loads=True, cross=True, slow=False))
    return environment.carry_out(rng, environment.draw_machine(rng), axis, moves, heat=1.0, room_k=0.5)


@pytest.mark.parametrize("module", GENERATOR)
def test_a_module_of_the_generator_imports_numbers_and_itself_only(module):
    tree = ast.parse((TESTS / "study" / "grammar" / f"{module}.py").read_text())
    names = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    names += [alias.name for n in ast.walk(tree) if isinstance(n, ast.Import) for alias in n.names]
    foreign = {name for name in names if name.split(".")[0] not in (*sys.stdlib_module_names, "numpy", "scipy")}
    assert all(name.startswith("study.grammar") for name in foreign)
    assert not any(
        name.startswith(("study.grammar.judge", "study.grammar.report", "study.grammar.equivalence"))
        for name in foreign
    )


@pytest.mark.outside
def test_the_generator_loads_nothing_of_the_project():
    code = (
        "import sys, study.grammar.machine; "
        "print([m for m in sys.modules if m.split('.')[0] in ('hil', 'drivers', 'sim_backends')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env={"PYTHONPATH": str(TESTS)}
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("lot", LOTS)
def test_a_number_gives_the_same_machine_each_time_and_another_number_another(lot):
    one, again, other = draw(lot, FIRST), draw(lot, FIRST), draw(lot, FIRST + 1)
    for a, b in ((one.fit, again.fit), (one.fresh, again.fresh)):
        assert a.records.keys() == b.records.keys()
        assert all(np.array_equal(a.records[name], b.records[name]) for name in a.records)
    assert not np.array_equal(one.fit.error_um[:50], other.fit.error_um[:50])


def test_the_two_ranges_of_numbers_share_none():
    assert not set(SEEDS["tuning"]) & set(SEEDS["reporting"])


@pytest.mark.parametrize(
    ("lot", "bounds"), [("strong", STRONG), ("weak", WEAK), ("outside strong", STRONG), ("outside weak", WEAK)]
)
@pytest.mark.outside  # draws dozens of machines
def test_a_cause_is_as_strong_as_asked_by_another_spline_fit(lot, bounds):
    checked = 0
    for seed in range(FIRST, FIRST + 12):
        drawn = draw(lot, seed)
        cause, values, rows = drawn.causes[0], drawn.fit.cause_um[0], drawn.fit.state
        assert bounds[0] <= drawn.ratios[0] <= bounds[1]
        if drawn.held[0] or drawn.older is not None:
            continue
        checked += 1
        squares, place = 0.0, rows.x_mm / rows.axis.travel_mm
        inner = np.linspace(-0.03, 1.03, 23)[1:-1]
        for side in (-1.0, 1.0):  # the same splines by truncated powers
            mine = rows.direction == side
            powers = [place[mine] ** k for k in range(4)] + [np.maximum(place[mine] - knot, 0.0) ** 3 for knot in inner]
            span, sizes, _ = np.linalg.svd(np.column_stack(powers), full_matrices=False)
            span = span[:, sizes > 1e-11 * sizes[0]]
            squares += float(np.sum((values[mine] - span @ (span.T @ values[mine])) ** 2))
        assert np.sqrt(squares / len(rows)) == pytest.approx(drawn.ratios[0] * drawn.sd_um, rel=0.01), cause.text
    assert checked >= 4


@pytest.mark.parametrize("kind", noise.KINDS)
@pytest.mark.outside  # draws dozens of machines
def test_noise_is_as_large_and_as_correlated_as_it_says(kind, state):
    rng = np.random.default_rng(1)
    drawn = noise.draw_noise(rng, kind, 0.7)
    values = np.array([drawn.draw(rng, state) for _ in range(300)])
    assert np.sqrt(np.mean(values**2)) == pytest.approx(drawn.sd_um(state), rel=0.04)
    covariance = drawn.covariance(state)
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), values.T)
    assert np.mean(whitened**2) == pytest.approx(1.0, rel=0.04)
    near = np.mean(values[:, 1:] * values[:, :-1], axis=0)
    assert np.mean(near) == pytest.approx(np.mean(np.diag(covariance, 1)), abs=0.03 * covariance[0, 0])


@pytest.mark.parametrize("lot", ["strong", "clean", "pairs"])
@pytest.mark.outside  # draws dozens of machines
def test_the_true_model_leaves_the_noise_on_fresh_rows(lot):
    over = []
    for seed in range(FIRST, FIRST + 8):
        drawn = draw(lot, seed)
        reference = Reference(
            drawn.fit.state, drawn.fit.error_um - drawn.fit.caused_um, drawn.noise.covariance(drawn.fit.state)
        )
        left = drawn.fresh.error_um - drawn.fresh.caused_um - reference.table_um(drawn.fresh.state)
        over.append(np.sqrt(np.mean(left**2)) / np.sqrt(np.mean(drawn.fresh.noise_um**2)))
    assert np.median(over) == pytest.approx(1.0, abs=0.05)
    assert max(over) < 1.25


def test_records_hold_pitch_causes_and_noise_and_nothing_else():
    drawn = draw("strong", FIRST + 1)
    error_um = (drawn.fit.records["measured_mm"] - drawn.fit.records["target_mm"]) * 1000.0
    assert error_um == pytest.approx(drawn.fit.error_um, abs=1e-3)


def test_what_a_cause_needs_is_logged_and_in_the_lot_for_it_is_not():
    for seed in range(FIRST, FIRST + 8):
        drawn = draw("strong", seed)
        assert set(drawn.causes[0].columns) - {"direction"} <= set(drawn.fit.records)
        bare = draw("missing", seed)
        assert bare.removed
        assert not set(bare.removed) & set(bare.fit.records)


def test_the_reference_test_keeps_its_false_rate(state):
    rng = np.random.default_rng(3)
    noisy = noise.draw_noise(rng, "mixed", 0.5)
    pitch_um = 4.0 * np.sin(3.0 * state.u) - 3.0 * state.direction
    cause_um = physics.draw_expansion(rng, state).values(state)
    reference = Reference(state, pitch_um + noisy.draw(rng, state), noisy.covariance(state))
    found = [reference.test(cause_um, pitch_um + noisy.draw(rng, state)) for _ in range(150)]
    assert 0.15 < np.mean(np.array(found) < 0.25) < 0.36  # 25 ± 3.5 %
    there = pitch_um + noisy.draw(rng, state) + cause_um * (0.5 / outside_um(cause_um, state))
    assert reference.test(cause_um, there) < 1e-4


def test_lost_motion_rises_as_named_after_a_long_stroke(state):
    rng = np.random.default_rng(0)
    cause = next(c for c in (physics.draw_lost_motion(rng, state) for _ in range(100)) if "exponential" in c.text)
    length_mm = float(cause.text.rsplit(" ", 2)[1])
    ways = length_mm * np.array([0.25, 0.5, 1.0, 2.0, 4.0])
    path = np.concatenate([[0.0, 50.0 * length_mm], 50.0 * length_mm - ways])
    moved = replace(state, path_mm=path, path_row=np.arange(len(path)))
    rise = cause.form(moved)[2:] - cause.form(moved)[1]
    assert rise == pytest.approx(1.0 - np.exp(-ways / length_mm), abs=0.03)


@pytest.mark.parametrize("name", physics.RECIPES)
def test_forms_of_every_known_cause_are_finite_and_vary(name, state):
    rng = np.random.default_rng(2)
    for _ in range(8):
        values = physics.RECIPES[name].draw(rng, state).values(state)
        assert np.all(np.isfinite(values))
        assert np.std(values) > 0


KNOWN = {
    "load": lambda s: s.load_kg * (s.x_mm - 40.0),
    "reversal by load": lambda s: s.load_kg * s.direction,
    "expansion": lambda s: (s.temperature_c["nut"] - 20.0) * (s.x_mm - 90.0),
    "drift": lambda s: s.temperature_c["motor"],
    "skew": lambda s: s.y_mm * s.x_mm,
    "bow": lambda s: s.z_mm**2,
    "lag": lambda s: s.velocity_mm_s,
    "arm": lambda s: s.yaw_urad,
    "air": lambda s: s.refractivity * s.x_mm,
    "slip": lambda s: (s.time_s > s.time_s[len(s) // 2]) * 1.0,
}


@pytest.mark.parametrize("name", KNOWN)
def test_a_known_cause_is_no_outside_cause(name, state):
    assert outside.left_of_known(KNOWN[name](state), state) < 0.5 * outside.LEAST_LEFT


def test_what_known_forms_represent_is_not_composed(state, monkeypatch):
    monkeypatch.setattr(outside, "left_of_known", lambda values, state: 0.49)
    assert not any(outside.draw_outside(np.random.default_rng(k), state, "product") for k in range(5))


@pytest.mark.parametrize("family", outside.FAMILIES)
def test_every_family_can_be_composed(family, state):
    found = [outside.draw_outside(np.random.default_rng(k), replace(state, key=(1, k)), family) for k in range(12)]
    assert any(found)
    assert all(np.all(np.isfinite(cause.values(state))) for cause in found if cause)


def test_a_row_knows_the_travel_since_its_reversal(state):
    since, ahead, before = 0.0, 0.0, state.path_mm[0]
    expected = []
    for place in state.path_mm:
        way = place - before
        if way and np.sign(way) != ahead:
            since, ahead = 0.0, float(np.sign(way))
        since, before = since + abs(way), place
        expected.append((since, ahead))
    rows = np.array(expected)[state.path_row]
    assert state.since_reversal_mm == pytest.approx(rows[:, 0])
    assert np.array_equal(state.direction, rows[:, 1])
    assert np.all(np.diff(state.time_s) > 0)


def test_a_cause_with_the_same_columns_is_a_twin_and_one_with_others_is_not(state):
    noisy = noise.draw_noise(np.random.default_rng(1), "white", 0.2).covariance(state)
    load = physics.Cause("not in any list", "", lambda now: now.load_kg, ("load_kg",), 0.0, 1.0)
    name, distance = twin(load, state, noisy, {"load_kg"})
    assert name == "load"
    assert distance < 1e-6 * float(load.values(state) @ np.linalg.solve(noisy, load.values(state)))
    assert twin(load, state, noisy, {"pos_y_mm", "pitch_urad"})[1] > DISTANCE


def test_every_cause_has_a_name_of_the_catalogue():
    assert set(equivalence.RIGHT) == {*physics.RECIPES, "settling"}  # a form of drift
    named = {name for names in equivalence.RIGHT.values() for name in names} | set(equivalence.ALWAYS_THERE)
    assert named == NAMES


def test_wilson_interval_as_published():
    # 81 of 263: 0.2553 to 0.3662 (Newcombe 1998, Statistics in Medicine 17, table I, method 3)
    assert report.share([True] * 81 + [False] * 182)["wilson_95"] == pytest.approx([0.2553, 0.3662], abs=1e-4)


def test_a_ratio_of_shares_is_that_of_the_same_machines() -> None:
    """Where a machine is named exactly when it is detected the ratio is 1 in every draw; of independent ones the width is by the
    delta method: sqrt(0.1 / 0.9 / n + 0.1 / 0.9 / n) · 1.96.
    """
    half = [True, False] * 100
    assert report.ratio(half, half) == pytest.approx({"ratio": 1.0, "low": 1.0, "high": 1.0})
    rng = np.random.default_rng(5)
    hits, of = rng.random(2000) < 0.9, rng.random(2000) < 0.9
    found = report.ratio(list(hits), list(of))
    assert found["high"] - found["low"] == pytest.approx(2 * 1.96 * np.sqrt(2 * 0.1 / 0.9 / 2000), rel=0.15)
    assert report.ratio([False], [False]) == {}


def test_a_first_name_below_one_of_its_rivals_is_not_the_likeliest() -> None:
    def said(confidence: float) -> dict[str, object]:
        return {"said": {"findings": [{"confidence": confidence, "rivals": [["cyclic", 0.4, ""], ["abbe", 0.1, ""]]}]}}

    assert report.likeliest(said(0.5))
    assert not report.likeliest(said(0.3))
    assert not report.likeliest({"said": {"findings": []}})


def test_the_slopes_of_a_form_are_its_derivatives_to_what_it_was_drawn_with(state):
    """Of load · (x - stiff) / travel: -load / travel. Of 1 - e^(-t/τ): -t/τ² · e^(-t/τ); what it takes from the rows is none."""
    rng = np.random.default_rng(0)
    loads = next(cause for cause in (physics.draw_load(rng, state) for _ in range(50)) if "along" in cause.text)
    by = dict(physics.slopes(loads.form))
    assert by.keys() == {"stiff"}
    np.testing.assert_allclose(by["stiff"](state), -state.load_kg / state.axis.travel_mm, atol=1e-9)
    settles = next(cause for cause in (physics.draw_drift(rng, state) for _ in range(50)) if "settles" in cause.text)
    tau_s = float(settles.text.split()[-2])
    by = dict(physics.slopes(settles.form))
    assert by.keys() == {"tau_s"}
    expected = -state.time_s / tau_s**2 * np.exp(-state.time_s / tau_s)
    np.testing.assert_allclose(by["tau_s"](state), expected, rtol=0.02, atol=1e-3 * float(np.max(np.abs(expected))))
    cycle = next(
        cause for cause in (physics.draw_cyclic(rng, state) for _ in range(200)) if "× 0.00, uneven 0.00" in cause.text
    )
    period_mm, turn = cycle.constants["period_mm"], 2.0 * np.pi * state.x_mm / cycle.constants["period_mm"]
    by = dict(physics.slopes(cycle.form))
    phase = np.arctan2(
        *np.linalg.lstsq(np.column_stack([np.cos(turn), np.sin(turn)]), cycle.form(state), rcond=None)[0]
    )
    np.testing.assert_allclose(by["period_mm"](state), -turn / period_mm * np.cos(turn + phase), rtol=1e-3, atol=1e-3)
    warm = next(c for c in (physics.draw_drift(rng, state) for _ in range(50)) if "lag 0 s" in c.text)
    by = dict(physics.slopes(warm.form))
    assert by.keys() == {"lag_s"}
    place = warm.text.split()[2].removeprefix("temp_").rstrip(",")
    behind = physics.lagged(state.temperature_c[place], state.time_s, 30.0) - state.temperature_c[place]
    np.testing.assert_allclose(by["lag_s"](state), behind / 30.0, atol=1e-12)
    assert not list(physics.slopes(physics.draw_dead_path(rng, state).form))
    assert not list(physics.slopes(physics.draw_datum(rng, state).form))
