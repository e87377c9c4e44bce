"""A model of named effects: the table, and effects that the user states the machine has. Only their forms and
parameters are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence

from threadpoolctl import threadpool_limits

from drivers.errors import InputError
from hil.diagnosis.campaign import prepare
from hil.diagnosis.model.candidates import Catalogue
from hil.diagnosis.model.evidence import Part
from hil.diagnosis.model.force import Force, compensated
from hil.diagnosis.model.intervals import terms_of
from hil.diagnosis.model.rows import ModelRows
from hil.diagnosis.model.search import Search
from hil.effects import Action, Effect
from hil.effects.model import Model
from hil.records.rows import Records


def fit_model(records: Records, effects: Sequence[Effect] = ()) -> Model:
    """The declared model of records: a bidirectional table, smoothed as far as the repeats allow, and each of these effects in the
    form, and with the parameters, that explain the records best, all fitted together.

    Raises InputError for too few rows, for an effect that is never corrected, and for one that these records cannot show.
    """
    for effect in effects:
        if effect.action is not Action.COMPENSATE:
            raise InputError(
                f"effect {effect.id} is never corrected ({effect.action.value}); a model holds what the machine does"
            )
    with threadpool_limits(1, "blas"):
        rows = ModelRows(prepare(records))
        search = Search(rows, Catalogue(rows, effects))
        missing = {effect.id for effect in effects}
        parts: list[Part] = []
        while missing:
            best = next((one for one in search.alternatives(parts, remainder=False) if one.part.name in missing), None)
            if best is None:
                names = ", ".join(sorted(missing))
                raise InputError(
                    f"these records cannot show {names}: a column is missing or does not vary, or the table contains it"
                )
            parts.append(best.part)
            missing.remove(best.part.name)
        fit = search.fit(parts)
        return Force(fit, compensated(parts, terms_of(fit))).model()
