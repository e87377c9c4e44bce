"""What another choice of targets would change: by hand, and by machines measured at other targets again and again."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from drivers.errors import InputError
from hil.figures.iso230 import iso230
from hil.figures.target_choice import highest_um, mean_um
from hil.figures.uncertainty import UncertaintyInputs, budget, budget_um
from hil.figures.verdict import accuracy
from hil.records.rows import Records

Machine = Callable[[np.ndarray], np.ndarray]
FINE = UncertaintyInputs(device_um=0.001)
"""An instrument whose own uncertainty does not count."""
MACHINES: dict[str, Machine] = {
    "screw": lambda x: 1.3 * np.sin(2 * np.pi * x / 10 + 1.0) + 0.5 * np.sin(2 * np.pi * x / 5) + x / 700,
    "scale": lambda x: 12.0 * (x / 500) ** 2 + 0.4 * np.sin(2 * np.pi * x / 20),
    "belt": lambda x: 4.0 * np.sin(2 * np.pi * x / 500) + 0.7 * np.sin(2 * np.pi * x / 7),
}


def campaign(machine: Machine, rng: np.random.Generator, sections: int, runs: int) -> Records:
    """Both ways at one place at random in each section, with 0.3 µm of scatter and 0.4 µm of reversal."""
    places = np.linspace(0, 500, sections + 1)
    target = places[:-1] + rng.uniform(0.0, 1.0, sections) * np.diff(places)
    run, direction, at = np.meshgrid(np.arange(runs) + 1.0, [1.0, -1.0], target, indexing="ij")
    error_um = machine(at) + 0.2 * direction + 0.3 * rng.normal(size=at.shape)
    columns = {"run": run, "direction": direction, "target_mm": at, "measured_mm": at + error_um / 1000.0}
    return Records.of({name: values.reshape(-1) for name, values in columns.items()})


def test_three_targets_by_hand() -> None:
    """Of 0, 3, 0 the middle one is 3 above its neighbours: a scatter of 3/√1.5 = 2.449. The course is 0, 1.5, 0.

    Each place gets 2.449 or -2.449 with equal probability, so the highest is 3.949 in 1/2 of all cases, 2.449 in 3/8 and -0.949 in
    1/8: mean 2.774, variance 2.463. Student's t of one degree of freedom at 97.725 % is 13.968.
    """
    values = np.array([0.0, 3.0, 0.0])
    assert highest_um((values,)) == pytest.approx(13.968 * 2.463**0.5, rel=0.01)
    assert highest_um((values, values)) == pytest.approx(13.968 * (2 * 2.463) ** 0.5, rel=0.01)
    assert mean_um(values) == pytest.approx(13.968 * 2.449 / 3**0.5, rel=1e-3)


def test_what_no_choice_changes_adds_nothing() -> None:
    for straight in (np.zeros(7), np.linspace(-3.0, 8.0, 7)):
        assert highest_um((straight, -straight)) == pytest.approx(0.0, abs=1e-6)
        assert mean_um(straight) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("runs", "directions"), [(3, (1, -1)), (1, (1, -1)), (3, (-1,))])
def test_the_highest_values_of_its_curves_are_the_figure(runs: int, directions: tuple[int, ...]) -> None:
    records = campaign(MACHINES["belt"], np.random.default_rng(5), 9, runs)
    figures = iso230(records.where(np.isin(records.direction, directions)))
    there = {name: value for name, value in figures.figures().items() if value is not None and name != "B_mean"}
    assert {name: sum(map(np.max, curves)) for name, curves in figures.curves().items()} == pytest.approx(there)


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize(("sections", "runs"), [(6, 5), (20, 3)])
def test_a_stays_within_u_of_what_it_is_on_average_over_the_choices(name: str, sections: int, runs: int) -> None:
    """In about 95 of 100 campaigns, each with other targets; and U is not so large that it says nothing."""
    rng = np.random.default_rng(sections)
    many = [iso230(campaign(MACHINES[name], rng, sections, runs)) for _ in range(60)]
    A_um = np.array([one.A for one in many])
    stated_um = np.array([highest_um(one.curves()["A"]) for one in many])
    assert np.mean(np.abs(A_um - A_um.mean()) <= stated_um) >= 0.9
    assert 1.2 * A_um.std() < stated_um.mean() < 7.0 * A_um.std()
    B_um = np.array([one.B_mean for one in many])
    assert np.mean(np.abs(B_um - B_um.mean()) <= [mean_um(one.B_i) for one in many if one.B_i is not None]) >= 0.9


def test_two_targets_do_not_show_it_and_nothing_is_stated_then() -> None:
    records = campaign(MACHINES["scale"], np.random.default_rng(1), 2, 3)
    with pytest.raises(InputError, match="2 targets do not show what another choice would change"):
        budget(FINE, iso230(records), records)
    assert budget_um(FINE, iso230(records), records) == {}
    found = accuracy(records, FINE, 100.0, None)
    assert (found.U_um, found.decision.value) == (None, "undecided")
    assert "2 targets" in found.reason
