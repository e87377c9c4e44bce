"""Shapes as what runs: from 0 to the whole amount, rising, the same at one travel and at many, and refused where they are none."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from drivers.errors import InputError
from hil.correction.rise import (
    DEAD_ZONE,
    EXPONENTIAL,
    RUNNABLE,
    STRAIGHT_PIECES,
    TANH,
    TWO_TANH,
    Rise,
    RiseShape,
    rise_from_json,
)

PLACES = tuple(float(place) for place in range(1, 17))
RISES = [
    Rise(TWO_TANH, (8.0, 4.0), (0.5, 2.0, 1.0)),
    Rise(TANH, (8.0,), (0.5,)),
    Rise(EXPONENTIAL, (8.0,), (0.5,)),
    Rise(DEAD_ZONE, (8.0,), (0.5,)),
    Rise(STRAIGHT_PIECES, tuple(float(k % 3) for k in range(16)), PLACES),
]


@pytest.mark.parametrize("rise", RISES, ids=[rise.shape.name for rise in RISES])
def test_every_shape_rises_from_nothing_to_its_amount(rise: Rise) -> None:
    travels = np.linspace(0.0, 40.0, 4001)
    along = rise.along_um(travels)
    assert along[0] == 0.0
    assert np.all(np.diff(along) >= -1e-12)
    assert along[-1] == pytest.approx(rise.amount_um, rel=1e-6)
    assert [rise.risen_um(s) for s in travels[::37].tolist()] == pytest.approx(along[::37], abs=1e-12)
    assert rise_from_json(rise.to_json(), "here") == rise


UNEVEN = Rise(STRAIGHT_PIECES, (4.0, 6.0, *[0.0] * 14), (0.1, 0.3, *map(float, range(1, 15))))
"""4 µm over the first 0.1 mm, 6 µm over the next 0.2 mm."""


@pytest.mark.parametrize(
    ("rise", "travel_mm", "expected_um"),
    [
        (RISES[0], 2.0, 8.0 * math.tanh(4.0) + 4.0 * math.tanh(0.5)),
        (RISES[1], 0.5, 8.0 * math.tanh(1.0)),
        (RISES[2], 0.5, 8.0 * (1.0 - math.exp(-1.0))),
        (RISES[3], 0.25, 4.0),
        (RISES[4], 2.5, 0.0 + 1.0 + 0.5 * 2.0),
        (RISES[4], 16.0, 15.0),
        (UNEVEN, 0.05, 2.0),
        (UNEVEN, 0.2, 4.0 + 0.5 * 6.0),
        (UNEVEN, 0.3, 10.0),
    ],
)
def test_literal_values(rise: Rise, travel_mm: float, expected_um: float) -> None:
    assert rise.risen_um(travel_mm) == pytest.approx(expected_um, abs=1e-12)


@pytest.mark.parametrize(
    "rise",
    [
        Rise(TWO_TANH, (8.0, 0.0), (5.0, 0.1, 1.0)),
        Rise(TWO_TANH, (0.0, 4.0), (0.5, 2.0, 1.0)),
        Rise(TANH, (8.0,), (0.3,)),
        Rise(EXPONENTIAL, (8.0,), (0.3,)),
        Rise(DEAD_ZONE, (8.0,), (0.3,)),
        Rise(STRAIGHT_PIECES, (1.0,) * 16, PLACES),
    ],
    ids=lambda rise: f"{rise.shape.name} {rise.amounts_um[0]:g}",
)
def test_a_rise_has_settled_where_it_is_its_amount_to_the_last_bit(rise: Rise) -> None:
    assert rise.risen_um(rise.settled_mm) == rise.amount_um
    assert rise.risen_um(0.9 * rise.settled_mm) < rise.amount_um  # and not much later than it has to be


@pytest.mark.parametrize(
    ("shape", "amounts", "lengths"),
    [
        (TANH, (-1.0,), (0.5,)),
        (TANH, (1.0,), (0.0,)),
        (TANH, (1.0, 2.0), (0.5,)),
        (TWO_TANH, (1.0, 2.0), (0.5, 0.5)),
        (TWO_TANH, (1.0, math.nan), (0.5, 0.5, 0.0)),
        (STRAIGHT_PIECES, (1.0,) * 16, tuple(reversed(PLACES))),
        (STRAIGHT_PIECES, (1.0,) * 15, PLACES),
    ],
)
def test_what_is_no_rise_is_refused(shape: RiseShape, amounts: tuple[float, ...], lengths: tuple[float, ...]) -> None:
    with pytest.raises(InputError):
        Rise(shape, amounts, lengths)


GOOD: dict[str, Any] = RISES[1].to_json()


@pytest.mark.parametrize(
    ("obj", "message"),
    [
        (None, "is not an object"),
        ({**GOOD, "more": 1}, "is not an object with the keys"),
        ({**GOOD, "shape": "cubic"}, "names the shape 'cubic', expected one of two tanh"),
        ({**GOOD, "amounts_um": [True]}, "amounts_um is not a list of numbers"),
        ({**RISES[0].to_json(), "amounts_um": [8.0, "4"]}, "amounts_um is not a list of numbers"),
        ({**GOOD, "lengths_mm": "0.5"}, "lengths_mm is not a list of numbers"),
        ({**GOOD, "lengths_mm": [-0.5]}, "x.lost-motion: tanh"),
    ],
)
def test_a_stored_rise_that_is_none_is_refused_by_name(obj: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        rise_from_json(obj, "x.lost-motion")


def test_only_tanh_terms_make_the_published_form() -> None:
    assert RISES[0].form.onset_2_mm == 1.0
    assert {rise.shape.name for rise in RISES} == {shape.name for shape in RUNNABLE}
    with pytest.raises(InputError, match="straight pieces is no sum of tanh terms"):
        _ = RISES[4].form
