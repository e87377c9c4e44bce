"""The uncertainty of ISO 230-2's figures: each contribution by hand, the whole against campaigns with every error drawn."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from drivers.errors import InputError
from hil.figures.iso230 import iso230
from hil.figures.uncertainty import (
    Budget,
    Conformity,
    UncertaintyInputs,
    budget,
    budget_um,
    conformity,
    farthest_from_reference_c,
)
from hil.records.rows import Records

TARGETS = np.array([0.0, 103.0, 199.0, 310.0, 402.0, 500.0])
RUNS = 5
CAMPAIGNS = 120


def campaign(error_um: np.ndarray, **columns: float) -> Records:
    """error_um, shape (run, direction, target)."""
    runs, _, m = error_um.shape
    run = np.repeat(np.arange(1, runs + 1), 2 * m)
    direction = np.tile(np.repeat([1.0, -1.0], m), runs)
    target = np.tile(TARGETS, 2 * runs)
    measured = target + error_um.reshape(-1) / 1000.0
    extra = {name: np.full(len(run), value) for name, value in columns.items()}
    return Records.of({"run": run, "direction": direction, "target_mm": target, "measured_mm": measured, **extra})


FLAT = campaign(np.random.default_rng(1).normal(size=(RUNS, 2, len(TARGETS))))


def test_each_contribution_by_hand() -> None:
    """Over 0.5 m: 0.6 stands for 1/√3 in the standard."""
    inputs = UncertaintyInputs(
        device_um=0.1,
        device_um_per_m=0.8,
        misalignment_mm=1.0,
        temperature_range_c=1.4,
        expansion_um_per_m_c=12.0,
        expansion_range_um_per_m_c=2.0,
        deviation_c=5.0,
        variation_um=2.0,
    )
    found = budget(inputs, iso230(FLAT), FLAT)
    assert found.length_mm == pytest.approx(500.0)
    parts = {part.name: part.expanded_um for part in found.contributions}
    assert parts == pytest.approx(
        {
            "device": 0.5,
            "misalignment": 0.3 * 1.0**2 / 0.5,
            "temperature": 0.6 * 12.0 * 0.5 * 1.4,
            "expansion": 0.6 * 5.0 * 0.5 * 2.0,
            "environment": 0.6 * 2.0 * (4 + 2 / 5) ** 0.5,  # as it enters A of five runs
            "choice of targets": found.targets_um["A"],
        },
        rel=0.04,  # 0.57735 of 0.6, and half of it 0.28868 of 0.3
    )


def of_instrument_um(found: Budget) -> dict[str, float]:
    """U without what the choice of targets adds."""
    return {name: max(0.0, value**2 - found.targets_um[name] ** 2) ** 0.5 for name, value in found.figures_um.items()}


def test_the_parts_add_up_to_u_of_the_first_figure() -> None:
    inputs = UncertaintyInputs(device_um=0.5, misalignment_mm=2.0, variation_um=3.0)
    for records, lead in ((FLAT, "A"), (FLAT.where(FLAT.run == 1), "E"), (FLAT.where(FLAT.direction < 0), "A_down")):
        found = budget(inputs, iso230(records), records)
        assert found.lead == lead
        assert sum(part.expanded_um**2 for part in found.contributions) == pytest.approx(found.figures_um[lead] ** 2)


def test_the_figures_by_hand() -> None:
    """Five runs, six targets over 0.5 m: device 0.5 µm, misalignment 0.57735·4/(2·0.5) = 2.30940 µm, environment 0.57735·3 = 1.73205.

    U_L² = 0.25 + 5.33333 = 5.58333; u² = 3. E: 5.58333 + 2·3/5 = 6.78333; A: that + 12; M: 5.58333 + 3/5; B: 6/5; B̄: 6/(5·6);
    R↑: 12; R: 12 + 6/5.
    """
    inputs = UncertaintyInputs(device_um=0.5, misalignment_mm=2.0, variation_um=3.0)
    found = budget(inputs, iso230(FLAT), FLAT)
    assert [part.name for part in found.contributions] == [
        "device",
        "misalignment",
        "temperature",
        "expansion",
        "environment",
        "choice of targets",
    ]
    squares = {name: value**2 for name, value in of_instrument_um(found).items()}
    assert squares == pytest.approx(
        {"E": 6.783333, "E_up": 6.783333, "E_down": 6.783333, "A": 18.783333, "A_up": 18.783333, "A_down": 18.783333}
        | {"M": 6.183333, "B": 1.2, "B_mean": 0.2, "R_up": 12.0, "R_down": 12.0, "R": 13.2},
        rel=1e-6,
    )


def test_misalignment_over_another_length() -> None:
    """0.57735 · 2² / (2 · 0.199 m) = 5.80253 µm: shorter, and the same play is a larger angle."""
    near = FLAT.where(FLAT.target_mm < 200.0)
    parts = budget(UncertaintyInputs(misalignment_mm=2.0), iso230(near), near).contributions
    assert parts[1].expanded_um == pytest.approx(5.80253, rel=1e-5)


def test_without_inputs_nothing_is_known_and_steel_is_assumed() -> None:
    with pytest.raises(InputError, match="nothing but zeros"):
        budget(UncertaintyInputs(), iso230(FLAT), FLAT)
    assert budget_um(None, iso230(FLAT), FLAT) == budget_um(UncertaintyInputs(), iso230(FLAT), FLAT) == {}
    thermometer = UncertaintyInputs(temperature_range_c=1.0)
    parts = {one.name: one.expanded_um for one in budget(thermometer, iso230(FLAT), FLAT).contributions}
    assert parts["temperature"] == pytest.approx(11.7 * 0.5 / 3**0.5)  # 11.7 µm/(m °C), steel as ISO/TR 230-9 has it


def test_how_far_from_20_degrees_the_records_say_where_nobody_else_does() -> None:
    """0.57735 · 3 °C · 0.5 m · 2 µm/(m °C) = 1.73205 µm."""
    warm = campaign(np.zeros((1, 2, 6)), temp_screw_c=23.0)
    inputs = UncertaintyInputs(expansion_range_um_per_m_c=2.0)
    parts = budget(inputs, iso230(warm), warm).contributions
    stated = UncertaintyInputs(
        device_um=0.1, expansion_range_um_per_m_c=2.0, deviation_c=0.0
    )  # whatever the records say
    exact = budget(stated, iso230(warm), warm).contributions
    assert exact[3].expanded_um == 0.0
    assert "0.0 °C from 20 °C" in exact[3].how
    assert "0.0 °C from 20 °C" in budget(UncertaintyInputs(device_um=0.1), iso230(FLAT), FLAT).contributions[3].how
    assert parts[3].expanded_um == pytest.approx(1.7320508)
    assert "3.0 °C from 20 °C" in parts[3].how


def test_a_scale_error_is_in_no_reversal_and_no_repeatability() -> None:
    found = of_instrument_um(budget(UncertaintyInputs(device_um_per_m=2.0), iso230(FLAT), FLAT))
    assert {name for name, value in found.items() if value == 0.0} == {"R", "R_up", "R_down", "B", "B_mean"}
    assert {round(value, 9) for value in found.values() if value} == {1.0}


def test_figures_that_a_campaign_has_not_have_no_uncertainty() -> None:
    one = FLAT.where((FLAT.direction > 0) & (FLAT.run == 1))
    assert set(budget(UncertaintyInputs(variation_um=1.0), iso230(one), one).figures_um) == {"E_up"}


def test_how_far_from_20_degrees() -> None:
    assert farthest_from_reference_c(FLAT) is None
    assert farthest_from_reference_c(campaign(np.zeros((1, 2, 6)), air_temp_c=18.0)) == pytest.approx(2.0)
    both = campaign(np.zeros((1, 2, 6)), air_temp_c=29.0, temp_screw_c=23.5, temp_nut_c=15.0)
    assert farthest_from_reference_c(both) == pytest.approx(5.0)
    warming = both.with_column("temp_nut_c", np.r_[np.nan, np.linspace(20.0, 26.0, 11)])
    assert farthest_from_reference_c(warming) == pytest.approx(6.0)
    with pytest.raises(InputError, match="deviation_c"):
        budget(UncertaintyInputs(expansion_range_um_per_m_c=1.0), iso230(FLAT), FLAT)


def test_what_is_stated_holds_for_95_of_100_campaigns() -> None:
    """The same machine measured by a perfect instrument and by one with every error drawn anew: the figures' differences."""
    rng = np.random.default_rng(230)
    inputs = UncertaintyInputs(
        device_um_per_m=1.0, misalignment_mm=1.0, temperature_range_c=1.0, expansion_um_per_m_c=11.7, variation_um=1.5
    )
    inside: dict[str, list[bool]] = {}
    for _ in range(CAMPAIGNS):
        machine = 2.0 * rng.normal(size=len(TARGETS)) + np.array([[1.0], [-1.0]])[..., :] * rng.uniform(0, 2)
        truth = machine + 0.8 * rng.normal(size=(RUNS, 2, len(TARGETS)))
        length_mm = TARGETS - TARGETS[0]
        aside_mm = rng.uniform(0, 1.0)
        scale = rng.normal(0, 0.5e-6) + rng.uniform(-0.5, 0.5) * 11.7e-6
        stretch_um = 1000.0 * (scale * length_mm - length_mm * (aside_mm / 500.0) ** 2 / 2)
        seen = truth + stretch_um + rng.uniform(-0.75, 0.75, size=truth.shape)
        true_figures, figures = iso230(campaign(truth)).figures(), iso230(campaign(seen))
        stated = of_instrument_um(budget(inputs, figures, FLAT))
        for name, value in figures.figures().items():
            true = true_figures[name]
            assert value is not None
            assert true is not None
            inside.setdefault(name, []).append(abs(value - true) <= stated[name])
    assert len(inside) == 12
    for name, hits in inside.items():
        assert np.mean(hits) >= 0.95 - 2 * np.sqrt(0.95 * 0.05 / CAMPAIGNS), (name, np.mean(hits))


@pytest.mark.parametrize(
    ("value", "expanded", "decided"),
    [
        (3.0, 0.5, Conformity.PASS),
        (4.5, 0.5, Conformity.PASS),  # on the edge: value + U is the limit
        (4.6, 0.5, Conformity.UNDECIDED),
        (5.0, 0.5, Conformity.UNDECIDED),
        (5.5, 0.5, Conformity.UNDECIDED),  # value - U is the limit: not above it
        (5.6, 0.5, Conformity.FAIL),
        (1.0, None, Conformity.UNDECIDED),
        (9.0, None, Conformity.UNDECIDED),
        (1.0, 0.0, Conformity.UNDECIDED),
    ],
)
def test_a_limit_of_5_um_is_decided_by_the_rule_of_iso_14253_1(
    value: float, expanded: float | None, decided: Conformity
) -> None:
    assert conformity(value, expanded, 5.0) is decided


def test_a_wrong_pass_and_a_wrong_fail_are_at_most_2_3_percent() -> None:
    """The specific risk at the edges (JCGM 106, normal distribution): ILAC-G8:09/2019 gives < 2.5 % for a guard band U."""
    limit, u = 5.0, 0.4
    edges = np.arange(2.0, 8.0, 0.001)
    verdicts = [conformity(float(value), 2 * u, limit) for value in edges]
    last_pass = max(value for value, verdict in zip(edges, verdicts, strict=True) if verdict is Conformity.PASS)
    first_fail = min(value for value, verdict in zip(edges, verdicts, strict=True) if verdict is Conformity.FAIL)
    assert stats.norm.sf(limit, last_pass, u) == pytest.approx(0.02275, abs=2e-4)
    assert stats.norm.cdf(limit, first_fail, u) == pytest.approx(0.02275, abs=2e-4)


@pytest.mark.parametrize(("value", "expanded"), [(float("nan"), 1.0), (1.0, float("nan")), (1.0, -0.1)])
def test_what_is_not_a_number_or_no_uncertainty_is_refused(value: float, expanded: float) -> None:
    with pytest.raises(InputError, match="expected finite numbers"):
        conformity(value, expanded, 5.0)
