"""The users' page and the page of the lots against the outcomes of the frozen judge, and the model's page against the policy."""

from __future__ import annotations

import re
from dataclasses import fields

from study.grammar import frozen
from support.docs import PAGES

from hil.diagnosis.model.policy import USUAL, Policy
from hil.effects import ALL


def text_of(page: str) -> str:
    return PAGES[page].read_text(encoding="utf-8")


def test_the_page_of_the_lots_is_that_of_the_outcomes() -> None:
    assert text_of("diagnosis_lots") == frozen.page()


def test_the_users_page_has_six_rows_of_figures_one_in_a_cell() -> None:
    rows = frozen.summary(frozen.read(frozen.OUTCOMES / "model.jsonl"))
    assert len(rows) == 2 + 6
    assert "\n".join(rows) in text_of("diagnosis")
    for row in rows[2:]:
        assert all(len(re.findall(r"\d+", cell)) <= 1 for cell in row.split("|"))


def test_the_users_page_is_short_and_has_every_effect() -> None:
    text = text_of("diagnosis")
    assert len(re.findall(r"[\w\d]\S*", text)) <= 900
    assert all(f"`{effect.id}`" in text for effect in ALL)


def test_the_models_page_states_the_numbers_of_the_policy() -> None:
    text = text_of("model")
    for field in fields(Policy):
        assert f"| `{field.name}` | {getattr(USUAL, field.name):g} |" in text, field.name
