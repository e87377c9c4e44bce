"""The diagnosis (system E): from the residual of a correction to the effect that the model lacks."""

from __future__ import annotations

from hil.diagnosis.diagnose import diagnose
from hil.diagnosis.result import Diagnosis, Figures, Finding, RivalFound
from hil.diagnosis.search.fit import fit_model

__all__ = ["Diagnosis", "Figures", "Finding", "RivalFound", "diagnose", "fit_model"]
