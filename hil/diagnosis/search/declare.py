"""A model of named effects: the table, and effects that the user states the machine has. Only their forms and
parameters are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence

from threadpoolctl import threadpool_limits

from drivers.errors import InputError
from hil.diagnosis.campaign import prepare
from hil.diagnosis.search.candidates import enumerate_candidates
from hil.diagnosis.search.fit import Choice, Setting, fit_model, start_noise
from hil.diagnosis.search.rank import rank
from hil.diagnosis.search.searcher import Searcher
from hil.effects import Action, Effect
from hil.effects.model import Model
from hil.records.rows import Records


def fit_with(records: Records, wanted: Sequence[Effect]) -> Model:
    """The table and each wanted effect in the form, and with the parameters, that explain the records best, all fitted
    together.

    Raises InputError for too few rows, for an effect that is never corrected, and for one that these records cannot
    show.
    """
    for effect in wanted:
        if effect.action is not Action.COMPENSATE:
            raise InputError(
                f"effect {effect.id} is never corrected ({effect.action.value}); a model holds what the machine does"
            )
    if not wanted:
        return fit_model(records)
    with threadpool_limits(1, "blas"):
        campaign = prepare(records)
        searcher = Searcher(Setting.free(campaign), enumerate_candidates(campaign, wanted))
        noise = searcher.fit_noise((), start_noise(campaign))
        chosen: list[Choice] = []
        missing = {effect.id for effect in wanted}
        while missing:
            searcher.limit_outliers(chosen, noise)
            best = next((r for r in rank(searcher, chosen, noise) if r.effect in missing), None)
            if best is None:
                names = ", ".join(sorted(missing))
                raise InputError(
                    f"these records cannot show {names}: a column is missing or does not vary, or the table holds it"
                )
            chosen.append(best.choice)
            missing.remove(best.effect)
            noise = searcher.fit_noise(chosen, best.noise)
        return searcher.fit_of_unknown_noise(chosen, noise).extended
