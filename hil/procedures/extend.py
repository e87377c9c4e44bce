"""From a diagnosis back to the machine: the extended model as what is put into force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.compensation import Compensation
from hil.effects.base import Term
from hil.model import Model, PitchTable
from hil.tables import DirectionalTable, SingleTable, TableSet


def compensation_of(model: Model, like: TableSet) -> Compensation:
    """What a fitted model comes to as tables and terms; mode, specified accuracy and straightness stay those of `like`.

    The straightness table of `like` is part of the same command, so its share is taken out of the pitch table.
    """
    nodes = np.array(model.table.positions_mm)
    own = like.straightness is not None and not like.straightness_axis
    share = like.straightness.at(nodes) if own and like.straightness is not None else np.zeros(len(nodes))
    pitch = DirectionalTable(
        nodes, -np.array(model.table.forward_um) - share, -np.array(model.table.backward_um) - share
    )
    backlash = SingleTable(nodes, pitch.plus_um - pitch.minus_um)
    return Compensation(replace(like, pitch=pitch, backlash=backlash), model.terms)


def model_of(compensation: Compensation) -> Model:
    """What a compensation in force comes to as a declared model: the opposite of `compensation_of`.

    A deliberate deviation (specified accuracy) is not an error of the machine and stays out.
    """
    tables = compensation.tables
    nodes = tables.pitch.position_mm
    own = tables.straightness is not None and not tables.straightness_axis
    share = tables.straightness.at(nodes) if own and tables.straightness is not None else np.zeros(len(nodes))
    table = PitchTable.of(nodes, -(tables.pitch.plus_um + share), -(tables.pitch.minus_um + share))
    return Model(table, tuple(term for term in compensation.terms if isinstance(term, Term)))
