"""The diagnosis (system E): from the residual of a correction to the effect that the model lacks.

What scripts use is imported when asked for: verbs that measure read its plans and stored results, and the search is slow to load.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hil.diagnosis.fitting import fit_model
    from hil.diagnosis.model.diagnosing import diagnose
    from hil.diagnosis.result import Diagnosis, Figures, Finding, RivalFound

__all__ = ["Diagnosis", "Figures", "Finding", "RivalFound", "diagnose", "fit_model"]

_PLACES = {"diagnose": "model.diagnosing", "fit_model": "fitting"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_PLACES.get(name, 'result')}"), name)
