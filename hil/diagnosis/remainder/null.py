"""What a campaign is when nothing is left in it: table, run offsets, the effects found, noise with memory whose size differs
from run to run, with the speed and along the travel.

The rows are weighted first, so that noise that grows with speed is no structure; then the noise model is fitted again (REML).
Every noise model that fits nearly as well is kept: what is said must hold under all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Extra, LinearCampaign, Noise, Projection
from hil.diagnosis.noise.noise_fit import fit_noise
from hil.diagnosis.policy import policy

Floats = NDArray[np.float64]

CORRELATIONS = ((0.0, 0.0), (0.35, 0.9), (0.5, 0.5), (0.5, 0.8), (0.7, 0.9), (1.0, 0.5))
"""(ar, rho) tried: memory of ordinary noise. A stronger one would be fitted to the structure that is looked for."""
OFFSETS = (0.0, 0.25, 0.6)
MOST_MODELS = 6
QUARTERS = 4
FLIPS = 200
"""Draws of the signs: the scale of what the best of many reaches is then known to 7 % (standard deviation of 200 Gumbel values)."""
MOST_SPEEDS = 8
"""Distinct speeds that are groups of their own; more are grouped by quarters of the rows."""


@dataclass(frozen=True)
class Null:
    """A campaign of weighted rows with the effects found.

    linear: table and offsets; y: errors, µm, (n,); beside: columns of the effects
    noise: of highest evidence; others: those nearly as good
    """

    linear: LinearCampaign
    y: Floats
    beside: Extra
    noise: Noise
    others: tuple[Noise, ...]

    @classmethod
    def of(cls, linear: LinearCampaign, y: Floats, beside: Extra, noise: Noise) -> Null:
        """From the errors y (n,) in µm, columns of the effects, and the noise model that they were found with."""
        campaign = linear.campaign
        calm = replace(noise, ar=0.0, rho=0.0)
        projection = linear.projection(calm, y, beside)
        residual = projection.whitened.colour(projection.solve(np.zeros((len(y), 0))).residual)
        scale = row_scale(residual, campaign)
        weighted = LinearCampaign(replace(campaign, scale=scale), linear.shape)
        best = fit_noise(weighted, y, beside, calm, correlations=CORRELATIONS, near=True)
        trials = [
            replace(best, ar=ar, rho=rho, offset=offset)
            for ar, rho in CORRELATIONS
            for offset in (*OFFSETS, best.offset)
        ]
        worth = {
            trial: float(weighted.projection(trial, y, beside).log_null) for trial in dict.fromkeys([best, *trials])
        }
        top = max(worth, key=lambda trial: worth[trial])
        good = sorted(
            (t for t in worth if t != top and worth[t] > worth[top] - policy().strong), key=lambda t: -worth[t]
        )
        return cls(weighted, y, beside, top, tuple(good[:MOST_MODELS]))

    @property
    def scale(self) -> Floats:
        """Relative standard deviation of the noise of each row, (n,)."""
        scale = self.linear.campaign.scale
        return np.ones(len(self.y)) if scale is None else scale

    def plus(self, random: Floats) -> Null:
        """With further random columns of unit variance ratio, (n, r), in µm."""
        return replace(self, beside=Extra(self.beside.free, np.hstack([random, self.beside.random])))

    def under(self, noise: Noise) -> Projection:
        """Everything of the null projected out, under one of its noise models."""
        return self.linear.projection(noise, self.y, self.beside)

    @cached_property
    def best(self) -> Projection:
        """Under the noise model of highest evidence."""
        return self.under(self.noise)

    @cached_property
    def signs_anew(self) -> tuple[Floats, Floats]:
        """Residuals z with the signs of the whitened rest drawn anew, under the noise model of highest evidence: Pz, (n, FLIPS), and
        z'Pz, (FLIPS,), P what projects everything of the null out.

        The draws have no random effects of the null. Where these take a fifth of the degrees of freedom they say too much of chance.
        """
        signs = np.random.default_rng(0).choice((-1.0, 1.0), size=(len(self.best.rest), FLIPS))
        drawn = signs * self.best.rest[:, None]
        projected = self.best.projected
        rest = drawn - projected @ (projected.T @ drawn)
        return rest, np.maximum(np.einsum("nk,nk->k", drawn, rest), 1e-300)

    @cached_property
    def nearly_as_good(self) -> tuple[Projection, ...]:
        """Under the others."""
        return tuple(self.under(noise) for noise in self.others)


def row_scale(residual: Floats, campaign: CampaignRows) -> Floats:
    """Relative standard deviation of each row's noise, (n,), from a residual (n,): by run, by speed, by quarter of the travel.

    A product of robust scales (median of the magnitudes), each drawn towards 1 by rows of average noise; its root mean square is 1.
    Magnitudes are limited first: a group that varies many times more than the others holds a cause.
    """
    size = np.abs(residual)
    usual = float(np.median(size))
    size = np.minimum(size, policy().most_uneven * usual)
    scale = np.ones(len(residual))
    if usual <= 0.0:
        return scale
    for group in (campaign.run, _speeds(campaign), _quarters(campaign.x)):
        for number in np.unique(group):
            rows = group == number
            own = float(np.median(size[rows] / scale[rows])) / usual
            count = int(np.sum(rows))
            scale[rows] *= np.sqrt((count * own**2 + policy().pseudo_rows) / (count + policy().pseudo_rows))
    return np.asarray(scale / np.sqrt(np.mean(scale**2)))


def _speeds(campaign: CampaignRows) -> NDArray[np.int64]:
    """Group of each row by the magnitude of its speed; one group where it is not known."""
    if not campaign.survey.has("velocity_mm_s"):
        return np.zeros(len(campaign), dtype=np.int64)
    speed: Floats = np.round(np.abs(campaign.columns["velocity_mm_s"]), 3).astype(np.float64)
    levels, group = np.unique(speed, return_inverse=True)
    return np.asarray(group if len(levels) <= MOST_SPEEDS else _quarters(speed), dtype=np.int64)


def _quarters(values: Floats) -> NDArray[np.int64]:
    edges = np.quantile(values, np.linspace(0.0, 1.0, QUARTERS + 1)[1:-1])
    return np.asarray(np.searchsorted(edges, values), dtype=np.int64)
