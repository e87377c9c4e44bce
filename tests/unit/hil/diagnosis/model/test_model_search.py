"""The objective of the search, log evidence less what each part must be worth: it rises with every change, and ends where none."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from support.campaigns import Array, campaign, wavy

from hil.diagnosis.campaign import AllRows
from hil.diagnosis.model.candidates import Catalogue
from hil.diagnosis.model.evidence import Candidate, Part
from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.model.rows import ModelRows
from hil.diagnosis.model.search import Search
from hil.effects import ALL, Effect


def errors(c: dict[str, Array]) -> Array:
    return wavy(c) + np.sin(2.0 * np.pi * c["target_mm"] / 10.0) + 0.01 * c["target_mm"] * (c["temp_screw_c"] - 20.0)


def warm(c: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    return {"temp_screw_c": 20.0 + 3.0 * (1.0 - np.exp(-c["time_s"] / 200.0)) + 0.05 * rng.normal(size=len(c["run"]))}


@functools.cache
def search() -> Search:
    rows = ModelRows(AllRows.of(campaign(errors, sensors=warm, seed=5), 0).searched)
    return Search(rows, Catalogue(rows, ALL))


def worth(parts: tuple[Part, ...]) -> float:
    return search().scored(parts)[0].log_p - USUAL.named * len(parts)


@pytest.mark.parametrize("first", [slice(0, 3), slice(3, 0, -1)])
def test_parts_that_are_too_many_end_as_the_true_ones_whatever_their_order(first: slice) -> None:
    parts = tuple(one.part for one in search().alternatives(()))[first]
    ended = search().exchanged(parts)
    assert worth(ended) > worth(parts)
    assert search().exchanged(ended) == ended
    found = search().run(ended)
    assert {part.name for part in found.parts} == {"cyclic", "thermal_expansion"}
    assert worth(found.parts) == pytest.approx(worth(search().run().parts), abs=1.0)


def test_a_zone_between_two_targets_is_larger_there_than_on_the_rows() -> None:
    """A bump half-way, an eighth of the gap wide: exp(8) of its value at the targets. A cycle is as large on the rows as anywhere."""
    catalogue = search().catalogue
    x = np.sort(catalogue.campaign.x)
    gap = int(np.argmax(np.diff(x)))
    middle, width = (x[gap] + x[gap + 1]) / 2.0, (x[gap + 1] - x[gap]) / 8.0
    forms = {(grid.effect.id, grid.form.name): grid for grid in catalogue.grids}
    wave = forms["cyclic", "fundamental"]
    bump = next(form for form in wear().forms(catalogue.campaign.survey) if form.name == "bump")
    ratio = catalogue.between_rows(Candidate(wear(), bump, (middle, width)), np.array([-2.0]))
    assert 0.9 * np.exp(8.0) < ratio < 1.01 * np.exp(8.0)
    assert catalogue.between_rows(Candidate(wave.effect, wave.form, (10.0,)), np.array([0.3, 1.0])) < 1.01


def wear() -> Effect:
    return next(effect for effect in ALL if effect.id == "local_wear")
