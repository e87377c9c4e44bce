"""The numbers of the verdict: each stated with its unit, meaning and origin, each read somewhere, and on the page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hil.diagnosis.policy import Policy, in_force, policy

ROOM = Path(__file__).parents[4] / "hil" / "diagnosis"
PAGE = ROOM.parent / "docs" / "policy.md"


@pytest.mark.parametrize("name", Policy.table())
def test_each_number_is_stated_read_and_on_the_page(name: str) -> None:
    value, unit, meaning, origin = Policy.table()[name]
    assert isinstance(value, float)
    assert unit
    assert meaning
    assert origin
    reads = re.compile(rf"policy\(\)\.{name}\b")
    assert any(reads.search(path.read_text(encoding="utf-8")) for path in ROOM.rglob("*.py")), "nothing reads it"
    assert f"| `{name}` | {value:g} |" in PAGE.read_text(encoding="utf-8")


def test_another_policy_is_in_force_only_inside() -> None:
    usual = policy()
    with in_force(Policy(strong=1.0)):
        assert policy().strong == 1.0
        with in_force(Policy(strong=2.0)):
            assert policy().strong == 2.0
        assert policy().strong == 1.0
    assert policy() == usual == Policy()
