"""The fitted model of an axis: table and effects added up by hand, its file as text, and every file that is none."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping

import numpy as np
import pytest

from drivers.errors import InputError
from hil.effects import ALL, Form, NonLinear, Term
from hil.effects.base import Straight
from hil.effects.model import Model, PitchTable
from hil.effects.warming import as_far_as_seen, is_bounded

EFFECTS = {effect.id: effect for effect in ALL}
TABLE = PitchTable((0.0, 100.0, 200.0), (0.0, 4.0, 2.0), (-1.0, -3.0, -1.0))
BACKLASH = Term(EFFECTS["backlash"], Form("backlash", "constant", ("direction",)), (), (0.5,), ((0.01,),))
STEEL = Term(
    EFFECTS["thermal_expansion"],
    Form("thermal_expansion", "temperature", ("temp_screw_c", "target_mm")),
    (),
    (11.0,),
    ((0.04,),),
)
LOST = Term(
    EFFECTS["lost_motion"],
    Form("lost_motion", "exponential", ("since_reversal_mm", "direction"), {}, (NonLinear("length_mm", 0.1, 90.0),)),
    (10.0,),
    (6.0,),
    ((0.01, 0.0), (0.0, 0.04)),
)


def test_a_table_is_straight_between_its_nodes_and_held_beyond_them() -> None:
    """Forward halfway from 4 to 2 is 3, backward a quarter from -1 to -3 is -1.5; at 250 mm the last values."""
    at = np.array([150.0, 25.0, 250.0, 250.0, -9.0])
    way = np.array([1.0, -1.0, 1.0, -1.0, -1.0])
    assert TABLE.error_um(at, way).tolist() == [3.0, -1.5, 2.0, -1.0, -1.0]
    assert PitchTable.of([[0, 10]], np.array([1, 2]), [3, 4]) == PitchTable((0.0, 10.0), (1.0, 2.0), (3.0, 4.0))
    one = PitchTable((5.0,), (1.0,), (-1.0,))  # a single position is a table
    assert one.error_um(np.array([0.0, 9.0]), np.array([1.0, -1.0])).tolist() == [1.0, -1.0]
    assert PitchTable((0.0, 0.5), (1.0, 2.0), (1.0, 2.0), (0, 1), ((0.0,) * 4,) * 4).nodes == (0, 1)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"positions_mm": (), "forward_um": (), "backward_um": ()}, "at least one position, strictly ascending"),
        ({"positions_mm": (0.0, 100.0, 100.0)}, "strictly ascending"),
        ({"positions_mm": (0.0, 200.0, 100.0)}, "strictly ascending"),
        ({"forward_um": (0.0, 1.0)}, "table.forward_um has 2 values for 3 positions"),
        ({"backward_um": (0.0, 1.0, 2.0, 3.0)}, "table.backward_um has 4 values for 3 positions"),
        ({"nodes": (0, 3)}, "table.nodes names a position that is not there"),
        ({"nodes": (0, -1)}, "table.nodes names a position that is not there"),
        ({"nodes": (0,), "covariance_um2": ((1.0, 0.0),)}, "table.covariance_um2 is not 2 × 2"),
        ({"nodes": (0,), "covariance_um2": ((1.0, 0.0), (1.0,))}, "table.covariance_um2 is not 2 × 2"),
        ({"covariance_um2": ((1.0,),)}, "table.covariance_um2 is not 0 × 0"),
    ],
)
def test_a_table_whose_parts_do_not_agree_is_refused(change: Mapping[str, tuple[float, ...]], said: str) -> None:
    parts = {"positions_mm": TABLE.positions_mm, "forward_um": TABLE.forward_um, "backward_um": TABLE.backward_um}
    with pytest.raises(InputError, match=said):
        PitchTable(**{**parts, **change})  # type: ignore[arg-type]


def test_the_error_is_the_table_and_every_effect_beside_it_and_the_correction_its_opposite() -> None:
    """At 150 mm forward 3 µm, at 25 mm backward -1.5; ± 0.5 µm of backlash; 11 ppm/K · x at 30 °C: 16.5 and 2.75 µm."""
    model = Model(TABLE).with_terms([BACKLASH, STEEL, BACKLASH])
    columns = {
        "target_mm": np.array([150.0, 25.0]),
        "direction": np.array([1.0, -1.0]),
        "temp_screw_c": np.array([30.0, 30.0]),
    }
    assert model.error_um(columns) == pytest.approx([3.0 + 1.0 + 16.5, -1.5 - 1.0 + 2.75])
    assert model.correction_um(columns) == pytest.approx([-20.5, -0.25])
    assert model.table is TABLE
    assert model.declared == ["pitch_table", "backlash", "thermal_expansion"]
    assert model.needs == {"temp_screw_c"}
    with pytest.raises(InputError, match="temp_screw_c"):
        model.error_um({name: columns[name] for name in ("target_mm", "direction")})


def test_history_that_is_missing_is_made_up_from_the_rows_alone() -> None:
    """Up 0 → 100, back by 10 mm and by 10 more: 6·e^-10 and 6·e^-1, 6·e^-2 downwards, on a table of zeros."""
    flat = Model(PitchTable((0.0,), (0.0,), (0.0,)), (LOST,))
    assert flat.needs == {"since_reversal_mm"}
    rows = {
        "target_mm": np.array([0.0, 100.0, 90.0, 80.0]),
        "direction": np.array([1.0, 1.0, -1.0, -1.0]),
    }
    found = flat.error_um(rows | {"run": np.ones(4)})
    assert found == pytest.approx([6.0, 6.0 * math.exp(-10.0), -6.0 * math.exp(-1.0), -6.0 * math.exp(-2.0)])
    with pytest.raises(InputError, match="since_reversal_mm"):
        flat.error_um(rows)
    given = flat.error_um(rows | {"since_reversal_mm": np.array([10.0, 0.0, 0.0, 20.0])})
    assert given == pytest.approx([6.0 * math.exp(-1.0), 6.0, -6.0, -6.0 * math.exp(-2.0)])


TEXT = """{
 "format": "hil-model",
 "version": 1,
 "about": {
  "axis": "Ständer µ",
  "rows": 40
 },
 "table": {
  "positions_mm": [
   0.0,
   10.0
  ],
  "forward_um": [
   1.0,
   2.0
  ],
  "backward_um": [
   3.0,
   4.0
  ],
  "nodes": [
   1
  ],
  "covariance_um2": [
   [
    1.0,
    0.25
   ],
   [
    0.25,
    4.0
   ]
  ]
 },
 "terms": [
  {
   "effect": "backlash",
   "form": "constant",
   "inputs": [
    "direction"
   ],
   "constants": {},
   "nonlinear": {},
   "coefficients": [
    0.5
   ],
   "covariance": [
    [
     0.01
    ]
   ]
  }
 ]
}
"""
WRITTEN = Model(
    PitchTable((0.0, 10.0), (1.0, 2.0), (3.0, 4.0), (1,), ((1.0, 0.25), (0.25, 4.0))),
    (BACKLASH,),
    {"axis": "Ständer µ", "rows": 40},
)


def test_the_model_file_letter_by_letter() -> None:
    assert WRITTEN.to_json() == TEXT
    assert Model.from_json(TEXT) == WRITTEN
    with pytest.raises(ValueError, match="JSON compliant"):
        Model(TABLE, (), {"load": math.nan}).to_json()  # a file of no standard is never written


def test_a_term_that_was_read_says_of_an_undetermined_parameter_what_one_that_was_fitted_does() -> None:
    """10 ± 10 mm: a factor of e² either way; the file holds no range that was searched, so neither bound is left out."""
    vague = Term(LOST.effect, LOST.form, (10.0,), (6.0,), ((0.01, 0.0), (0.0, 100.0)))
    (read,) = Model.from_json(Model(TABLE, (vague,)).to_json()).terms
    known = {name: one.value for name, one in read.parameters.items()}
    assert known == {
        "amount_um": 6.0,
        "least_length_mm": pytest.approx(10.0 / math.e**2),
        "most_length_mm": pytest.approx(10.0 * math.e**2),
    }


WARM = {"target_mm": np.array([0.0, 500.0, 1000.0]), "temp_screw_c": np.array([20.5, 21.0, 22.0])}


def test_a_bounded_temperature_counts_as_far_as_it_was_seen_at_every_place() -> None:
    """0.5 to 2 K above 20 °C were seen: 11 ppm/K make 5.5 to 22 µm at 1 m, a quarter of it at 250 mm."""
    bounded = as_far_as_seen(STEEL, WARM)
    assert is_bounded(bounded)
    assert not is_bounded(STEEL)
    assert bounded.error_um(WARM) == pytest.approx(STEEL.error_um(WARM))
    for degrees, risen_k in ((30.0, 2.0), (15.0, 0.5), (21.2, 1.2)):
        columns = {"target_mm": np.array([250.0, 1000.0]), "temp_screw_c": np.full(2, degrees)}
        assert bounded.error_um(columns) == pytest.approx([2.75 * risen_k, 11.0 * risen_k])
    assert isinstance(bounded.along({"target_mm": 0.0, "temp_screw_c": 30.0}), Straight), "a stream asks for two places"
    assert Model.from_json(Model(TABLE, (bounded,)).to_json()).terms == (bounded,)


def test_a_bound_grows_with_what_is_seen_later_and_never_shrinks() -> None:
    bounded = as_far_as_seen(STEEL, WARM)
    later = {**WARM, "temp_screw_c": np.array([21.0, 21.5, 24.0])}
    grown = as_far_as_seen(bounded, later)
    assert (grown.form.constants["least_rise_k"], grown.form.constants["most_rise_k"]) == (0.5, 4.0)
    some = as_far_as_seen(STEEL, later, np.array([True, True, False]))
    assert (some.form.constants["least_rise_k"], some.form.constants["most_rise_k"]) == (1.0, 1.5)


def test_through_a_lag_it_is_what_the_lag_let_through() -> None:
    """A step of 4 K through a lag of 1000 s, read after 100 s and again after 10,000: a tenth of it was seen, not 4 K."""
    drift = Term(
        EFFECTS["thermal_drift"],
        Form("thermal_drift", "lagged temperature", ("temp_screw_c", "time_s"), {}, (NonLinear("lag", 1.0, 1e5),)),
        (1000.0,),
        (1.0,),
        ((0.01, 0.0), (0.0, 1.0)),
    )
    step = {"temp_screw_c": np.array([20.0, 24.0, 24.0]), "time_s": np.array([0.0, 0.001, 100.0])}
    seen_um = drift.error_um(step)
    assert max(seen_um) == pytest.approx(4.0 * (1.0 - math.exp(-0.1)), rel=0.05)
    long = {name: np.append(values, values[-1]) for name, values in step.items()} | {
        "time_s": np.append(step["time_s"], 1e4)
    }
    assert drift.error_um(long)[-1] > 3.9
    assert as_far_as_seen(drift, step).error_um(long)[-1] == pytest.approx(max(seen_um))


NO_MODEL = r'is not a model file: expected "format": "hil-model"'
TABLE_KEYS = "table must be an object with the keys"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": "hil-sealed"}, NO_MODEL),
        ({"version": 2}, "is of version 2, expected 1"),
        ({"version": None}, "is of version None, expected 1"),
        ({"effects": []}, "has the keys .*'effects'.*, expected"),
        ({"about": ["axis"]}, "about is not an object of plain values"),
        ({"about": {"axis": "X", "rows": [40]}}, "about is not an object of plain values"),
        ({"terms": {}}, "terms is not a list"),
        ({"terms": ["backlash"]}, r"terms\[0\] is not an object"),
        ({"table": []}, TABLE_KEYS),
        ({"table": {"positions_mm": [0.0]}}, TABLE_KEYS),
    ],
)
def test_a_file_that_is_no_model_is_refused_with_its_name(change: Mapping[str, object], said: str) -> None:
    with pytest.raises(InputError, match=rf"x\.json: {said}"):
        Model.from_json(json.dumps({**json.loads(TEXT), **change}), "x.json")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"covariance_um2": {}}, "table.covariance_um2 is not a list"),
        ({"covariance_um2": [1.0, 2.0]}, "table.covariance_um2 is not a list"),
        ({"nodes": [0, 0.5]}, "table.nodes holds a number that is not whole"),
        ({"nodes": 1}, "table.nodes is not a list"),
        ({"positions_mm": [0.0, "10"]}, "table.positions_mm holds '10', expected a finite number"),
        ({"forward_um": None}, "table.forward_um is not a list"),
        ({"backward_um": [1.0]}, "table.backward_um has 1 values for 2 positions"),
    ],
)
def test_a_table_of_a_file_is_refused_by_the_key_that_is_wrong(change: Mapping[str, object], said: str) -> None:
    plain = json.loads(TEXT)
    with pytest.raises(InputError, match=rf"x\.json: {said}"):
        Model.from_json(json.dumps({**plain, "table": {**plain["table"], **change}}), "x.json")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", rf"x\.json: {NO_MODEL}"),
        ("{}", rf"x\.json: {NO_MODEL}"),
        ('{\n "format":,\n}', r"x\.json:2: is not a model file: Expecting value"),
        ("[" * 100_000 + "]" * 100_000, r"x\.json: is not a model file: nested too deeply"),  # of no line
    ],
)
def test_a_text_that_is_no_object_is_refused_with_its_line_where_there_is_one(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        Model.from_json(text, "x.json")
