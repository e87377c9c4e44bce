"""Between a diagnosis and the machine: what may be fitted, and the extended model as what is put into force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.correction.compensation import Compensation
from hil.correction.tables import DirectionalTable, SingleTable, TableSet
from hil.effects.base import Term
from hil.effects.model import Model, PitchTable
from hil.machine.session import AxisSession
from hil.records.rows import REQUIRED, Floats, Records


def compensation_of(model: Model, like: TableSet) -> Compensation:
    """What a fitted model comes to as tables and terms; mode, specified accuracy and straightness stay those of `like`.

    The straightness table of `like` is part of the same command, so its share is taken out of the pitch table.
    """
    nodes = np.array(model.table.positions_mm)
    share = _straightness_share_um(like, nodes)
    pitch = DirectionalTable(
        nodes, -np.array(model.table.forward_um) - share, -np.array(model.table.backward_um) - share
    )
    backlash = SingleTable(nodes, pitch.plus_um - pitch.minus_um)
    return Compensation(replace(like, pitch=pitch, backlash=backlash), model.terms)


def bounded(session: AxisSession, model: Model, like: TableSet, rows: Records) -> Compensation:
    """`compensation_of`, held against the axis's bound: along the axis, and in the rows that the model was fitted to.

    Raises CorrectionBoundError naming the worst place.
    """
    extended, what = compensation_of(model, like), "extended correction not used"
    extended.check(session.steering.bound, what)
    extended.check_rows(session.steering.bound, what, rows.columns)
    return extended


def model_of(compensation: Compensation) -> Model:
    """What a compensation in force comes to as a declared model: the opposite of `compensation_of`.

    A deliberate deviation (specified accuracy) is not an error of the machine and stays out.
    """
    tables = compensation.tables
    nodes = tables.pitch.position_mm
    share = _straightness_share_um(tables, nodes)
    table = PitchTable.of(nodes, -(tables.pitch.plus_um + share), -(tables.pitch.minus_um + share))
    return Model(table, tuple(term for term in compensation.terms if isinstance(term, Term)))


def _straightness_share_um(tables: TableSet, nodes_mm: Floats) -> Floats:
    """What the straightness table adds to the axis's own command at the nodes; nothing where it corrects another axis."""
    if tables.straightness is None or tables.straightness_axis:
        return np.zeros(len(nodes_mm))
    return tables.straightness.at(nodes_mm)


def issuable(session: AxisSession, records: Records) -> Records:
    """The records without what is only known after a motion (motor position and torque at the capture).

    An effect that reads such a column could be fitted, and never be put into force.
    """
    known = {*session.known(), *REQUIRED, "command_mm", "since_reversal_mm", "stroke_mm"}
    return Records.of({name: values for name, values in records.columns.items() if name in known})
