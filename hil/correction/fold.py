"""Folding: fitted effects that depend on position and direction alone are put into the tables.

Controllers and drives hold tables and no effects.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.errors import InputError
from hil.correction.compensation import Compensation, ErrorTerm, fits_in_a_table
from hil.correction.tables import DirectionalTable, SingleTable
from hil.records.rows import Floats

FINE_UM = 0.05
"""Largest distance of a straight line between two nodes from the effect, µm: less than a laser resolves at rest on a machine."""
MOST_NODES = 20_000
"""Largest number of nodes of a table."""
TRIED = np.sort(np.modf(np.arange(1, 8) * (np.sqrt(5) - 1) / 2)[0])
"""Places between two nodes at which the line is compared: multiples of the golden ratio, so that no period matches them all."""


def folded(compensation: Compensation) -> Compensation:
    """The same correction with every effect that a table can hold moved into the tables, within `FINE_UM` over their span.

    Raises InputError for an effect that needs more than `MOST_NODES` nodes.
    """
    static = [term for term in compensation.terms if fits_in_a_table(term)]
    if not static:
        return compensation
    tables = compensation.tables
    nodes = _nodes(tables.pitch.position_mm, static)
    if tables.backlash is not None:
        nodes = np.union1d(nodes, tables.backlash.position_mm)
    plus, minus = (_error_um(static, nodes, sign) for sign in (1, -1))
    pitch = DirectionalTable(nodes, tables.pitch.at(nodes, 1) - plus, tables.pitch.at(nodes, -1) - minus)
    backlash = tables.backlash
    if backlash is not None:
        backlash = SingleTable(nodes, backlash.at(nodes) + minus - plus)
    rest = tuple(term for term in compensation.terms if term not in static)
    return replace(compensation, tables=replace(tables, pitch=pitch, backlash=backlash), terms=rest)


def _nodes(nodes: Floats, terms: list[ErrorTerm]) -> Floats:
    """The nodes, with nodes added until straight lines follow the effects in both directions, mm."""
    while len(nodes) > 1:
        left, step = nodes[:-1, None], np.diff(nodes)[:, None]
        between = left + step * TRIED
        off = np.zeros(between.shape)
        for sign in (1, -1):
            ends = _error_um(terms, nodes, sign)
            line = ends[:-1, None] + np.diff(ends)[:, None] * TRIED
            wanted = _error_um(terms, between.ravel(), sign).reshape(between.shape)
            off = np.maximum(off, np.abs(wanted - line))
        bent = np.max(off, axis=1) > FINE_UM
        if not np.any(bent):
            break
        nodes = np.union1d(nodes, nodes[:-1][bent] + 0.5 * np.diff(nodes)[bent])
        if len(nodes) > MOST_NODES:
            raise InputError(
                f"the fitted effects need more than {MOST_NODES} nodes to be held by a table within {FINE_UM:g} µm"
            )
    return nodes


def _error_um(terms: list[ErrorTerm], position_mm: Floats, sign: int) -> Floats:
    columns = {"target_mm": position_mm, "direction": np.full(len(position_mm), float(sign))}
    return np.asarray(np.sum([term.error_um(columns) for term in terms], axis=0), dtype=np.float64)
