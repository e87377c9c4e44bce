"""A finding that rests on a few rows: three that agree by chance are no lost motion, one that the other rows show too is."""

from __future__ import annotations

import numpy as np
import pytest

from hil.diagnosis import diagnose
from hil.records.rows import Records

TURNED = (40, 80, 120)
"""Rows at once after a reversal; the nearest others are 6 mm after one."""


def campaign(at_once_um: float, at_6_mm_um: float) -> Records:
    """8 runs of 40 rows at random targets, noise of 0.5 µm; so much is added at 0 and 6 mm after a reversal, with the direction."""
    rng = np.random.default_rng(11)
    n = 320
    since = rng.uniform(40.0, 300.0, n)
    since[rng.choice(np.setdiff1d(np.arange(n), TURNED), 40, replace=False)] = 6.0
    since[list(TURNED)] = 0.0
    direction = np.where(rng.random(n) < 0.5, 1.0, -1.0)
    target = rng.uniform(0.0, 400.0, n)
    error_um = 0.5 * rng.normal(size=n)
    error_um[list(TURNED)] = 0.0
    error_um += direction * (at_once_um * (since == 0.0) + at_6_mm_um * (since == 6.0))
    return Records.of(
        {
            "run": np.repeat(np.arange(1.0, 9.0), 40),
            "direction": direction,
            "target_mm": target,
            "measured_mm": target + error_um / 1000.0,
            "time_s": np.arange(n) * 7.0,
            "since_reversal_mm": since,
            "stroke_mm": np.full(n, 300.0),
        }
    )


def test_three_rows_that_agree_are_no_finding() -> None:
    found = diagnose(campaign(-2.8, 0.0))
    assert found.findings == ()


@pytest.mark.parametrize("at_once_um", [-3.4, -8.0])
def test_three_rows_far_beyond_the_noise_are_a_finding(at_once_um: float) -> None:
    found = diagnose(campaign(at_once_um, 0.0))
    assert [finding.effect for finding in found.findings] == ["lost_motion"]


def test_what_other_rows_show_as_well_is_a_finding() -> None:
    found = diagnose(campaign(-3.0, -0.8))
    assert [finding.effect for finding in found.findings] == ["lost_motion"]
