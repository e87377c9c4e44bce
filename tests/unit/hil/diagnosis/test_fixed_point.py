"""Growth of a screw that is held somewhere else than at the axis's zero."""

from __future__ import annotations

import numpy as np
import pytest
from support.workshop import TRAVEL_MM, Floats, workshop

from hil.diagnosis import diagnose
from hil.effects import ALL, Survey, Term, survey_of
from hil.effects.history import complete
from hil.effects.thermal_expansion import fixed_point_mm

EXPANSION = next(effect for effect in ALL if effect.id == "thermal_expansion")


PPM_K = 4.0


@pytest.mark.parametrize("point_mm", [TRAVEL_MM, 0.5 * TRAVEL_MM])
def test_growth_about_any_point_is_expansion_and_holds_after_another_warm_up(point_mm: float) -> None:
    def grown_um(c: dict[str, Floats]) -> Floats:
        return PPM_K * 1e-3 * (c["target_mm"] - point_mm) * (c["temp_screw_c"] - 20.0)

    diagnosis = diagnose(workshop(3, grown_um)[0])
    assert [finding.effect for finding in diagnosis.findings] == ["thermal_expansion"]
    finding = diagnosis.findings[0]
    assert "temp_screw_c" in finding.term.needs  # the temperature that was measured, not a course of time
    for name, true in (("fixed_point_mm", point_mm), ("coefficient_ppm_per_k", PPM_K)):
        estimate = finding.parameters[name]
        assert abs(estimate.value - true) < 3.0 * estimate.std, name
        assert estimate.std < 0.1 * true, name
    fresh, noise = workshop(3, grown_um, warm_s=4000.0, warm_k=9.0)
    left = fresh.uncorrected_error_um - diagnosis.extended.error_um(fresh.columns)
    assert np.sqrt(np.mean(left**2)) < 1.25 * np.std(noise)


def test_the_point_and_its_uncertainty_are_those_of_the_quotient() -> None:
    """By simulation from the stated covariance."""
    form = next(f for f in EXPANSION.forms(_survey()) if f.name == "temperature, about a fixed point")
    covariance = np.array([[0.04, -0.003], [-0.003, 0.0006]])
    term = Term(EXPANSION, form, (), (11.5, -3.45), tuple(map(tuple, covariance)))
    point = fixed_point_mm(term)
    assert point is not None
    assert point.value == pytest.approx(300.0)
    drawn = np.random.default_rng(1).multivariate_normal([11.5, -3.45], covariance, 200_000)
    assert point.std == pytest.approx(np.std(-drawn[:, 1] / (drawn[:, 0] * 1e-3)), rel=0.02)
    unknown = Term(EXPANSION, form, (), (0.5, -3.45), tuple(map(tuple, covariance)))
    assert fixed_point_mm(unknown) is None
    assert "do not determine" in EXPANSION.explain(unknown)


def test_a_point_far_outside_the_machine_is_implausible() -> None:
    form = next(f for f in EXPANSION.forms(_survey()) if f.name == "temperature, about a fixed point")
    for point_mm, bad in ((0.0, False), (500.0, False), (770.0, False), (1500.0, True), (-700.0, True)):
        term = Term(EXPANSION, form, (), (11.5, -11.5e-3 * point_mm), ((0.0,) * 2,) * 2)
        assert (EXPANSION.implausible(term) is not None) is bad, point_mm


def _survey() -> Survey:
    return survey_of(complete(workshop(1)[0].columns))
