"""The verdict on an axis: which rows it is of, and what is decided by them."""

from __future__ import annotations

import numpy as np
import pytest

from hil.figures.iso230 import iso230
from hil.figures.uncertainty import UncertaintyInputs
from hil.figures.verdict import Accuracy, At, Decision, accuracy, targets_of
from hil.records.rows import Records

TARGETS = (10.0, 55.0, 103.0, 148.0, 201.0)
LENGTH_M = 0.191
PROVING = UncertaintyInputs(device_um=0.3, device_um_per_m=1.0)


def rows(targets_mm: tuple[float, ...], *, corrected: bool = True) -> Records:
    """Two runs both ways, the second 1 µm above the first, the direction − 3 µm below."""
    columns: dict[str, list[float]] = {
        name: [] for name in ("run", "direction", "target_mm", "measured_mm", "command_mm")
    }
    for run in (1, 2):
        for direction in (1, -1):
            for target in targets_mm:
                error_um = float(run) - (3.0 if direction < 0 else 0.0)
                values = (run, direction, target, target + error_um / 1000.0, target + (0.002 if corrected else 0.0))
                for name, value in zip(columns, values, strict=True):
                    columns[name].append(float(value))
    return Records({name: np.array(values) for name, values in columns.items()})


def test_the_uncertainty_is_the_certificate_over_the_length_where_nothing_else_is_stated() -> None:
    """The errors of all targets are one and the same, so their choice adds nothing."""
    found = accuracy(rows(TARGETS), PROVING, 9.0, (0.0, 100.0))
    assert found.at is At.OTHER
    assert found.U_um == pytest.approx(0.3 + 1.0 * LENGTH_M)  # a + b·L, by hand
    assert found.A_um == pytest.approx(3.0 + 4.0 * np.sqrt(0.5))  # means 3 µm apart, s of two runs 1 µm apart, by hand
    assert found.A_um == iso230(rows(TARGETS)).A


@pytest.mark.parametrize(
    ("limit_um", "decision"),
    [
        (5.8285 + 0.4911, Decision.PASS),  # A is 5.8284, U 0.4910
        (5.8284 + 0.4909, Decision.UNDECIDED),
        (5.8284, Decision.UNDECIDED),
        (5.8284 - 0.4909, Decision.UNDECIDED),
        (5.8284 - 0.4912, Decision.FAIL),
        (None, Decision.NO_LIMIT),
    ],
)
def test_the_decision_has_a_guard_band_of_the_uncertainty_on_both_sides(
    limit_um: float | None, decision: Decision
) -> None:
    found = accuracy(rows(TARGETS), PROVING, limit_um, (0.0, 100.0))
    assert found.decision is decision
    assert found.good == (decision in (Decision.PASS, Decision.NO_LIMIT))
    assert found.as_json()["decision"] in str(found) or decision is Decision.NO_LIMIT


def test_rows_at_the_tables_targets_prove_nothing_however_small_their_error() -> None:
    for tables_mm, at in ((TARGETS, At.CALIBRATED), ((10.0, 300.0), At.MIXED), (None, At.UNKNOWN)):
        found = accuracy(rows(TARGETS), PROVING, 100.0, tables_mm)
        assert (found.at, found.decision) == (at, Decision.NOT_JUDGED)
        assert not found.good
        assert at.value in str(found)


def test_a_table_that_corrects_nothing_is_in_force_all_the_same() -> None:
    assert targets_of(rows(TARGETS, corrected=False), TARGETS) is At.UNCORRECTED
    assert targets_of(rows(TARGETS, corrected=False), TARGETS, corrected=True) is At.CALIBRATED


@pytest.mark.parametrize("inputs", [None, UncertaintyInputs(), UncertaintyInputs(expansion_range_um_per_m_c=1.0)])
def test_without_an_uncertainty_nothing_is_proven_and_the_reason_is_said(inputs: UncertaintyInputs | None) -> None:
    found = accuracy(rows(TARGETS), inputs, 100.0, (0.0, 100.0))
    assert (found.U_um, found.decision) == (None, Decision.UNDECIDED)
    assert found.missing
    assert found.missing in str(found)
    assert "±" not in found.value
    assert found.explained()[0].startswith("no U: ")


def test_without_a_limit_it_says_so_and_what_the_accuracy_is() -> None:
    found = Accuracy(6.16, 0.5, None, At.OTHER)
    assert str(found) == "A = 6.16 ± 0.50 µm at other targets; no limit given, so neither pass nor fail"
    assert found.explained() == ("± is the expanded uncertainty U (k = 2, about 95 %)",)


def test_it_says_what_u_is_made_of_the_largest_part_first_with_its_source() -> None:
    found = accuracy(rows(TARGETS), UncertaintyInputs(device_um=0.3, misalignment_mm=0.7), 9.0, (0.0, 100.0))
    assert (
        "U in µm from misalignment 0.74 (beam within 0.7 mm sideways), device 0.30; their squares add up"
        in found.explained()
    )
    parts = found.as_json()["parts_um"]
    assert sum(part**2 for part in parts.values()) == pytest.approx((found.U_um or 0.0) ** 2)


def test_a_mean_that_has_moved_is_said_of_a_verification_alone() -> None:
    """The mean of 1.5 - 3/2 is 0: nothing is said of it; with the datum 2 µm aside it is."""
    aside = rows(TARGETS).with_column("measured_mm", rows(TARGETS)["measured_mm"] - 0.002)
    for records, tables_mm, says in (
        (rows(TARGETS), (0.0, 100.0), False),
        (aside, (0.0, 100.0), True),
        (aside, TARGETS, False),
        (rows(TARGETS, corrected=False), (0.0, 100.0), False),
    ):
        found = accuracy(records, PROVING, 9.0, tables_mm)
        assert any("from the tables' zero" in one for one in found.explained()) == says
    found = accuracy(aside, PROVING, 9.0, (0.0, 100.0))
    assert found.as_json()["mean_um"] == pytest.approx(-2.0)
    assert any(one.startswith("the mean is -2.00 ± 0.00 µm from the tables' zero") for one in found.explained())
    assert found.A_um == accuracy(rows(TARGETS), PROVING, 9.0, (0.0, 100.0)).A_um
