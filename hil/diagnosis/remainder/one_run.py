"""A wave along the position in one run alone, tested against what that run's own rows vary.

The null takes a run that varies more than the others for a noisier one, and the limit of outliers cuts its rows; both hide a cause
that was there in one run only. Within the run such a cause is nearly all that varies, and noise of any size is not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.noise.evidence import Projection
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder.block import RATIOS, Block
from hil.diagnosis.remainder.null import Null
from hil.diagnosis.remainder.scan import FINE_POSITION, Variable, log10_tail

Floats = NDArray[np.float64]

LEAST_ROWS = 12
"""Fewest rows of a run that are searched for a wave of two columns beside its own mean."""


def in_one_run(null: Null, raw: Floats, x: Variable, d: Floats | None) -> Block | None:
    """The clearest wave of one run, from errors raw (n,) in µm that were not limited; None where the run's noise does as much."""
    campaign = null.linear.campaign
    waves = x.waves(x.periods(FINE_POSITION)).transpose(0, 2, 1)  # (periods, n, 2)
    signed = waves if d is None else np.concatenate([waves, waves * d[:, None]])
    models = [null.linear.projection(noise, raw, null.beside) for noise in (null.noise, *null.others)]
    best: tuple[float, Floats, bool] | None = None
    tests = len(signed) * campaign.runs
    for run in range(campaign.runs) if campaign.runs > 1 else ():
        rows = campaign.run == run
        if int(np.sum(rows)) < LEAST_ROWS:
            continue
        designs = signed * rows[:, None]
        scores = np.min([_scores(model, designs, rows) for model in models], axis=0)
        scores -= np.log10(tests)
        top = int(np.argmax(scores))
        if scores[top] > policy().scan_fires_at and (best is None or scores[top] > best[0]):
            best = float(scores[top]), designs[top], top >= len(waves)
    if best is None:
        return None
    score, design, directed = best
    names = ("run", "target_mm", "direction") if directed else ("run", "target_mm")
    return Block(names, design, score * np.log(10.0), RATIOS[-1])


def _scores(model: Projection, designs: Floats, rows: NDArray[np.bool_]) -> Floats:
    """-log10 of the chance that noise of a run's rows (n,) follows each wave (k, n, 2) as well, (k,)."""
    count = len(designs)
    white = model.prepared(designs.transpose(1, 0, 2).reshape(len(rows), -1))[rows]
    white = (white - white.mean(axis=0)).reshape(len(white), count, 2).transpose(1, 0, 2)
    rest = model.rest[rows] - np.mean(model.rest[rows])
    b = np.einsum("kni,n->ki", white, rest)
    normal = np.einsum("kni,knj->kij", white, white)
    size = np.einsum("kii->k", normal)
    explained = np.einsum(
        "ki,ki->k", b, np.linalg.solve(normal + 1e-9 * size[:, None, None] * np.eye(2), b[:, :, None])[:, :, 0]
    )
    return -log10_tail(explained / float(rest @ rest), 2, len(rest) * model.dof / model.rows - 1.0)
