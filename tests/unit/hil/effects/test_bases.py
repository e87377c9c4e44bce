"""Bases of many parameters at once are the single ones side by side."""

from __future__ import annotations

import numpy as np
import pytest

from hil.effects import ALL, Effect, survey_of
from hil.effects.history import complete


def columns(rows: int = 40) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(8)
    return complete(
        {
            "run": np.repeat([1.0, 2.0], rows // 2),
            "direction": np.tile([1.0, -1.0], rows // 2),
            "target_mm": rng.uniform(0.0, 300.0, rows),
            "measured_mm": rng.normal(size=rows),
            "time_s": np.cumsum(rng.uniform(2.0, 9.0, rows)),
            "velocity_mm_s": rng.choice([5.0, 20.0, 80.0], rows),
            "temp_screw_c": 20.0 + rng.normal(size=rows),
        }
    )


@pytest.mark.parametrize("effect", ALL, ids=lambda effect: effect.id)
def test_many_at_once_are_the_single_ones(effect: Effect) -> None:
    given = columns()
    for form in effect.forms(survey_of(given)):
        starts = form.starts[:40]
        single = np.hstack([effect.basis(form, theta, given) for theta in starts])
        np.testing.assert_allclose(effect.bases(form, starts, given), single, rtol=0, atol=1e-9)
