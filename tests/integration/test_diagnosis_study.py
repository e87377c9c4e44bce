"""The diagnosis judged on machines drawn at random (`tests/study`), whose truth shares no code with the effects that are fitted.

They were drawn for this catalogue, one effect at a time, to see that each is found at all. What is published comes from
`python tests/study/grammar`.
"""

from __future__ import annotations

import pytest
from study.own_catalogue import Case, run
from study.truth_machines import DYNAMIC

from hil.effects import ALL, Action


@pytest.mark.outside
@pytest.mark.parametrize("effect", DYNAMIC)
def test_a_strong_hidden_effect_is_named(effect: str) -> None:
    outcome = run(Case("strong", 20261 + DYNAMIC.index(effect), (effect,), (3.0,)))
    assert outcome.names[:1] == (effect,)
    assert outcome.after <= outcome.before or effect in instrument()


@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_found_on_a_clean_machine(seed: int) -> None:
    outcome = run(Case("clean", 977 + seed, (), ()))
    assert outcome.names == ()
    assert not outcome.unexplained


def instrument() -> set[str]:
    """Effects that are named and never compensated: what they do stays in the machine's error."""
    return {effect.id for effect in ALL if effect.action is not Action.COMPENSATE}
