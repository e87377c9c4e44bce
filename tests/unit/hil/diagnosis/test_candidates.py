"""All candidates scored at once, against each on its own and against least squares written out."""

from __future__ import annotations

import numpy as np
import pytest
from support.campaigns import campaign, wavy

from hil.diagnosis.campaign import prepare
from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise
from hil.diagnosis.search.candidates import Blocks, Stack, enumerate_candidates, score
from hil.effects import ALL
from hil.effects.cyclic import Cyclic
from hil.effects.datum_step import DatumStep

CAMPAIGN = prepare(campaign(lambda c: wavy(c) + 0.5 * np.sin(c["target_mm"] / 2.1), runs=4, targets=10))
BENCH = LinearCampaign(CAMPAIGN)
N = len(CAMPAIGN)
NOISE = Noise(ar=0.7, rho=0.9, offset=0.3, even=200.0, odd=50.0)
RNG = np.random.default_rng(3)
MIXED = Blocks.of([RNG.normal(size=(N, width)) for width in (1, 2, 1, 3, 5, 2)], N)


@pytest.mark.parametrize("out", [None, CAMPAIGN.run == 0], ids=["all rows", "without a run"])
@pytest.mark.parametrize("beside", [0, 2])
def test_the_scores_are_the_gains_of_each_block_alone(out: np.ndarray | None, beside: int) -> None:
    extra = Extra(RNG.normal(size=(N, beside)), np.zeros((N, 0)))
    projection = BENCH.projection(NOISE, CAMPAIGN.error_um, extra, out)
    scores = score(projection, Stack(projection.whitened, MIXED))
    expected = [projection.gain(MIXED.block(i)) for i in range(len(MIXED))]
    np.testing.assert_allclose(scores.gain, expected, atol=1e-4)
    assert np.all(scores.visible > 0.2)


def test_many_errors_are_scored_as_each_one_is() -> None:
    y = np.column_stack([CAMPAIGN.error_um, RNG.normal(size=N), np.cos(CAMPAIGN.x)])
    stack = Stack(BENCH.whitened(NOISE), MIXED)
    many = score(BENCH.projection(NOISE, y), stack).gain
    for i in range(3):
        one = score(BENCH.projection(NOISE, y[:, i]), stack).gain
        np.testing.assert_allclose(many[:, i], one, atol=1e-3)


def test_columns_of_any_size_are_scored_and_empty_ones_never() -> None:
    """Simulated errors are scored in single precision, which knows no 1e-50 and no 1e50."""
    z = RNG.normal(size=(N, 3))
    sizes = (1e-10, 1.0, 1e8)
    empty = np.zeros((N, 1))
    blocks = Blocks.of(
        [*(z * size for size in sizes), *(z[:, :1] * size for size in sizes), empty, np.hstack([empty, empty])], N
    )
    y = np.column_stack([CAMPAIGN.error_um, RNG.normal(size=N)])
    for errors in (y, y[:, 0]):
        projection = BENCH.projection(NOISE, errors)
        gain = score(projection, Stack(projection.whitened, blocks)).gain
        np.testing.assert_allclose(gain[[0, 2]], gain[[1, 1]], atol=1e-3)
        np.testing.assert_allclose(gain[[3, 5]], gain[[4, 4]], atol=1e-3)
        assert np.all(np.isneginf(gain[6:]))


def test_what_a_table_holds_is_invisible_and_never_scored() -> None:
    x, d = CAMPAIGN.x, CAMPAIGN.d
    blocks = Blocks.of([np.ones((N, 1)), (x * d)[:, None], d[:, None], RNG.normal(size=(N, 1))], N)
    projection = BENCH.projection(NOISE, CAMPAIGN.error_um)
    scores = score(projection, Stack(projection.whitened, blocks))
    assert np.all(np.isneginf(scores.gain[:3]))
    assert np.all(scores.visible[:3] < 0.01)
    assert np.isfinite(scores.gain[3])


def test_every_form_of_the_first_search_is_there_at_every_point_of_its_grid() -> None:
    candidates = enumerate_candidates(CAMPAIGN, ALL)
    forms = [form for effect in ALL for form in effect.forms(CAMPAIGN.survey) if form.scan]
    assert [len(index) for index in candidates.forms] == [len(form.starts) for form in forms]
    assert sum(candidates.blocks.width) == candidates.blocks.columns.shape[1]
    for index in (0, len(candidates) // 2, len(candidates) - 1):
        choice = candidates.choices[index]
        basis = choice.effect.basis(choice.form, choice.theta, CAMPAIGN.columns)
        np.testing.assert_array_equal(candidates.blocks.block(index), basis)
        assert candidates.effects[candidates.effect[index]] == choice.effect.id


def test_the_scan_of_periods_peaks_where_least_squares_does() -> None:
    candidates = enumerate_candidates(CAMPAIGN, (Cyclic(),))
    plain = Noise(even=1e-6, odd=1e-6)
    projection = BENCH.projection(plain, CAMPAIGN.error_um)
    gains = score(projection, candidates.stack(projection.whitened)).gain
    y = CAMPAIGN.error_um
    line = np.column_stack([np.ones(N), CAMPAIGN.x, CAMPAIGN.d, CAMPAIGN.d * CAMPAIGN.x])
    some = range(0, len(candidates), 7)
    rest = [
        float(np.sum((y - wide @ np.linalg.lstsq(wide, y, rcond=1e-8)[0]) ** 2))
        for wide in (np.hstack([line, candidates.blocks.block(i)]) for i in some)
    ]
    np.testing.assert_array_equal(np.argsort(-gains[some])[:20], np.argsort(rest)[:20])


@pytest.mark.parametrize("after", [0, 1, 7, 19, 20, 39, 40, 58, 78])
def test_a_jump_is_placed_between_its_rows(after: int) -> None:
    """Within a pass, at a reversal, at a run's end, and before the last row but one, of a campaign of 80 rows."""
    rows = np.arange(N)
    y = CAMPAIGN.error_um + np.where(rows > after, 6.0, 0.0)
    candidates = enumerate_candidates(CAMPAIGN, (DatumStep(),))
    projection = BENCH.projection(Noise(even=10.0, odd=10.0), y)
    found = candidates.choices[int(np.argmax(score(projection, candidates.stack(projection.whitened)).gain))]
    time_s = CAMPAIGN.columns["time_s"]
    assert time_s[after] < found.theta[0] < time_s[after + 1]


def test_a_thinned_scan_of_jumps_keeps_every_run_boundary() -> None:
    many = prepare(campaign(runs=30, targets=20))
    moments = np.array(many.survey.moments)
    assert len(moments) < 600
    time_s = many.columns["time_s"]
    ends = np.flatnonzero(np.diff(many.run))
    for end in ends:
        assert np.any((moments > time_s[end]) & (moments < time_s[end + 1]))
