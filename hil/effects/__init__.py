"""The catalogue of effects: the physical causes of an axis's error, one file each, behind one protocol
(`hil.effects.base`).

The list is the tuple `ALL` (`hil.effects.catalogue`). A user's own effects are appended in a tuple that is passed along
(`hil.effects.user_effects`). They are named on the command line (`hil diagnose --effects FILE.py`) or brought by an
installed package, never named by a data file.
"""

from __future__ import annotations

from hil.effects.base import Action, Columns, Effect, Estimate, Floats, Form, NonLinear, Rival, Term
from hil.effects.catalogue import ALL
from hil.effects.reading import NEVER_SEARCHED, term_from_json
from hil.effects.survey import Survey, survey_of

__all__ = [
    "ALL",
    "NEVER_SEARCHED",
    "Action",
    "Columns",
    "Effect",
    "Estimate",
    "Floats",
    "Form",
    "NonLinear",
    "Rival",
    "Survey",
    "Term",
    "survey_of",
    "term_from_json",
]
