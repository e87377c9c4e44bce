"""Which other causes would look the same on the rows of a campaign: where one does, no diagnosis can be sure of a
name.

The distance of a cause from a family of others is r' C⁻¹ r, with r what generalised least squares leaves of the cause
beside a free table and the family's columns, and C the true covariance of the noise. Only what was logged counts as a
rival: a free course of time represents everything slow, and a cause that was measured is preferred to it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import solve_triangular
from study.grammar.environment import Floats, State
from study.grammar.physics import Cause
from study.grammar.reference import free_table, left_beside

DISTANCE = 20.0
"""Below this distance (twice a log likelihood ratio) two causes are counted as not told apart: odds of e^10 before
any prior.
"""

FIXED_POINTS = (-1.6, -1.0, -0.5, 0.0, 0.5, 1.0, 1.6)
AIR_ORIGINS = (-1.4, -1.0, -0.8)
"""Where a rival's expansion or measured length may be zero, from -1 to 1 over the travel. With a free offset beside it
such a form would contain the plain offset, which is preferred as the smaller.
"""
TIME_INTERVALS, TIME_LEFT = 12, 0.3
ALONE_LEFT = 0.35
"""Part (RMS) of a cause that must be left beside one column for the other to count as a carrier."""


def families(state: State, logged: Collection[str]) -> Iterator[tuple[str, list[Floats]]]:  # noqa: PLR0912  (a list)
    """Name of this study's cause, and the columns of one form of it, for every form a logged column allows."""
    u, d, one = state.u, state.direction, np.ones(len(state))
    for place, course in state.temperature_c.items():
        if f"temp_{place}_c" in logged:
            for fixed in FIXED_POINTS:
                yield "expansion", [(course - 20.0) * (u - fixed)]
            yield "drift", [course]
    if "time_s" in logged:
        span = float(state.time_s[-1])
        for tau in (0.05, 0.15, 0.5, 1.5):
            yield "settling", [np.exp(-state.time_s / (tau * span))]
        for row in range(6, len(state) - 6, 3):
            yield "slip", [(np.arange(len(state)) >= row) * one]
    if "air_pressure_hpa" in logged and "air_temp_c" in logged:
        for origin in AIR_ORIGINS:
            yield "air", [state.refractivity * 1e6 * (u - origin)]
        yield "dead_air", [state.refractivity * 1e6]
    if "load_kg" in logged:
        yield "load", [state.load_kg, state.load_kg * u]
        yield "load", [state.load_kg * d, state.load_kg * d * u]
    if "torque_percent" in logged:
        yield "load", [state.torque_percent]
    if "velocity_mm_s" in logged:
        yield "lag", [state.velocity_mm_s]
    for name, angle in (("pitch_urad", state.pitch_urad), ("yaw_urad", state.yaw_urad)):
        if name in logged:
            yield "arm", [angle]
    for name, place_mm in (("pos_y_mm", state.y_mm), ("pos_z_mm", state.z_mm)):
        if name in logged:
            yield "cross", [place_mm, place_mm * u]
            yield "cross", [place_mm**2, place_mm]
    if "since_reversal_mm" in logged:
        for part in (0.002, 0.006, 0.02, 0.06):
            yield "wind_up", [d * np.exp(-state.since_reversal_mm / (part * state.axis.travel_mm))]


_ONE_NAME = ({"drift", "settling"},)
"""Causes that the catalogue calls by one name are no rivals of each other."""


def course_of_time(cause: Cause, state: State) -> bool:
    """Whether a smooth course of time (cubic splines of `TIME_INTERVALS`) holds what the table does not hold of a cause, all
    but a part of `TIME_LEFT` (RMS).
    """
    part = state.time_s / float(state.time_s[-1])
    inner = np.arange(-3, TIME_INTERVALS + 4) / TIME_INTERVALS
    time = BSpline.design_matrix(part, inner, 3).toarray()
    table = free_table(state)
    values = cause.values(state)
    beside_table = left_beside(values, table)
    return bool(np.std(left_beside(values, np.hstack([table, time]))) < TIME_LEFT * np.std(beside_table))


def carriers(cause: Cause, state: State, logged: Mapping[str, Floats]) -> list[str]:
    """The logged columns that carry a cause: one is left out where a free function of the others, per direction, holds all
    but a part of `ALONE_LEFT` of what the table does not hold.
    """
    wanted = [name for name in cause.columns if name in logged]
    table, values = free_table(state), cause.values(state)
    outside = float(np.std(left_beside(values, table)))
    needed = []
    for name in wanted:
        others = [_free(logged[other], state.direction) for other in wanted if other != name]
        left = float(np.std(left_beside(values, np.hstack([table, *others]))))
        if len(wanted) == 1 or left > ALONE_LEFT * outside:
            needed.append(name)
    return needed or wanted


def _free(column: Floats, direction: Floats) -> Floats:
    """A free function of a column, per direction: cubic splines, or a level for each of few values."""
    levels = np.unique(column)
    if len(levels) <= 2 * TIME_INTERVALS:
        basis = (column[:, None] == levels) * 1.0
    else:
        part = (column - levels[0]) / (levels[-1] - levels[0])
        basis = BSpline.design_matrix(part, np.arange(-3, TIME_INTERVALS + 4) / TIME_INTERVALS, 3).toarray()
    return np.hstack([basis, basis * direction[:, None]])


def twin(cause: Cause, state: State, covariance: Floats, logged: Collection[str]) -> tuple[str, float]:
    """The nearest other cause and its distance; ("", inf) where none is logged."""
    root = np.linalg.cholesky(covariance)

    def white(values: Floats) -> Floats:
        return np.asarray(solve_triangular(root, values, lower=True))

    table, _ = np.linalg.qr(white(free_table(state) + 0.0))
    target = white(cause.values(state))
    target = target - table @ (table.T @ target)
    same = {cause.name}.union(*(names for names in _ONE_NAME if cause.name in names))
    nearest, least = "", float("inf")
    for name, columns in families(state, logged):
        if name in same:
            continue
        span = white(np.column_stack(columns))
        span = span - table @ (table.T @ span)
        sizes = np.linalg.norm(span, axis=0)
        span = span[:, sizes > 1e-6] / sizes[sizes > 1e-6]
        left = target - span @ np.linalg.lstsq(span, target, rcond=1e-9)[0] if span.shape[1] else target
        distance = float(left @ left)
        if distance < least:
            nearest, least = name, distance
    return nearest, least
