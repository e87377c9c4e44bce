"""The figures of ISO 230-4:2005 for circular paths of two axes, as pure functions over positions. No I/O.

Radial deviation F: distance of the actual path from the nominal one, positive outwards, about the centre of the least-squares circle
(the standard's choice for full circles, which takes the set-up of the instrument out). Fmax, Fmin: its largest and smallest value.
Circular deviation G: the radial range of a path about its least-squares circle; the standard defines G by the minimum zone and allows
this evaluation, which is never smaller. Bi-directional G(b): the same of a clockwise and a counter-clockwise path about the
least-squares circle of both. Mean bi-directional radial deviation D: radius of that circle less the nominal radius.

Angles are in degrees, counter-clockwise from the + direction of the first axis. In a least-squares circle of two paths both have the
same weight, whatever their numbers of points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from drivers.errors import InputError
from hil.records.rows import UM_PER_MM, Floats

STANDARD = "ISO 230-4:2005"
MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "G": "circular deviation",
        "F_max": "largest radial deviation",
        "F_min": "smallest radial deviation",
        "G_b": "bi-directional circular deviation",
        "D": "mean bi-directional radial deviation",
    }
)
FEWEST = 36
"""Fewest points of a path: one in 10°, so that each quadrant has several."""
WIDEST_GAP_DEG = 20.0
"""Widest gap between neighbouring points of a full circle; an effect between them would be missed."""
FULL_DEG = 350.0
"""Shortest arc that counts as a full circle: the least-squares centre of an arc is not determined well enough."""
WRONG_RADIUS = 0.1
"""Share of the nominal radius that a path's radius differs by where it was misstated: a diameter is off by 0.5, a machine by 0.001."""
_STEPS, _CONVERGED_MM = 50, 1e-12


@dataclass(frozen=True)
class LeastSquaresCircle:
    """centre_mm of both axes and radius_mm of the circle with the least sum of squares of radial distances."""

    centre_mm: tuple[float, float]
    radius_mm: float


@dataclass(frozen=True)
class CircularPath:
    """One path. sense: +1 counter-clockwise, -1 clockwise; start_deg, end_deg: where it begins and ends, end - start is the arc with
    its sign.
    """

    sense: int
    circle: LeastSquaresCircle
    start_deg: float
    end_deg: float
    G_um: float
    F_max_um: float
    F_min_um: float

    @property
    def name(self) -> str:
        return "ccw" if self.sense > 0 else "cw"

    def as_json(self) -> dict[str, object]:
        return {
            "direction": self.name,
            "start_deg": self.start_deg,
            "end_deg": self.end_deg,
            "centre_mm": list(self.circle.centre_mm),
            "radius_mm": self.circle.radius_mm,
            "G_um": self.G_um,
            "F_max_um": self.F_max_um,
            "F_min_um": self.F_min_um,
        }


@dataclass(frozen=True)
class Iso230Part4:
    """Of one or two paths of one nominal radius. G_b_um, D_um: None with paths of one sense only."""

    radius_mm: float
    paths: tuple[CircularPath, ...]
    G_b_um: float | None
    D_um: float | None

    def as_json(self) -> dict[str, object]:
        return {
            "standard": STANDARD,
            "nominal_radius_mm": self.radius_mm,
            "evaluation": "about the least-squares circle",
            "paths": [path.as_json() for path in self.paths],
            "G_b_um": self.G_b_um,
            "D_um": self.D_um,
        }


def least_squares_circle(x_mm: Floats, y_mm: Floats, weight: Floats | None = None) -> LeastSquaresCircle:
    """The circle of positions, (n,) each, n ≥ 3. weight: of the squares, (n,). Method of Gauss and Newton from the algebraic circle.

    Raises InputError for positions on a line, and where the method does not converge.
    """
    root = np.ones(len(x_mm)) if weight is None else np.sqrt(weight)
    middle = np.array([x_mm.mean(), y_mm.mean()])
    u, v = x_mm - middle[0], y_mm - middle[1]
    design = np.column_stack([u, v, np.ones(len(u))]) * root[:, None]
    solution, _, rank, _ = np.linalg.lstsq(design, -(u**2 + v**2) * root, rcond=None)
    if len(u) < 3 or rank < 3:
        raise InputError("positions lie on a line, expected a circle")
    a, b = -0.5 * solution[:2]
    for _ in range(_STEPS):
        away = np.hypot(u - a, v - b)
        design = np.column_stack([(u - a) / away, (v - b) / away, np.ones(len(u))]) * root[:, None]
        da, db, radius = np.linalg.lstsq(design, away * root, rcond=None)[0]
        a, b = a + da, b + db
        if np.hypot(da, db) < _CONVERGED_MM * max(1.0, radius):
            away = np.hypot(u - a, v - b)
            mean = float(np.average(away, weights=root**2))
            return LeastSquaresCircle((float(a + middle[0]), float(b + middle[1])), mean)
    raise InputError("no least-squares circle of the positions was found")


def iso230_4(paths_mm: Sequence[tuple[Floats, Floats]], radius_mm: float) -> Iso230Part4:
    """The figures of one path, or of two of opposite sense.

    paths_mm: positions of both axes in order of time, (n,) each, one full turn. Raises InputError for a path that is no full
    circle, has too few points or gaps or another radius, and for two paths of one sense.
    """
    if not radius_mm > 0.0:
        raise InputError(f"nominal radius is {radius_mm:g} mm, expected more than 0")
    paths = tuple(_path(x, y, radius_mm) for x, y in paths_mm)
    if len(paths) != 2:
        return Iso230Part4(radius_mm, paths, None, None)
    if paths[0].sense == paths[1].sense:
        raise InputError(f"both paths are {paths[0].name}, expected one clockwise and one counter-clockwise")
    x, y = (np.concatenate([path[k] for path in paths_mm]) for k in (0, 1))
    weight = np.concatenate([np.full(len(path[0]), 1.0 / len(path[0])) for path in paths_mm])
    both = least_squares_circle(x, y, weight)
    away = np.hypot(x - both.centre_mm[0], y - both.centre_mm[1])
    return Iso230Part4(radius_mm, paths, float(np.ptp(away)) * UM_PER_MM, (both.radius_mm - radius_mm) * UM_PER_MM)


def _path(x_mm: Floats, y_mm: Floats, radius_mm: float) -> CircularPath:
    if len(x_mm) < FEWEST or len(x_mm) != len(y_mm):
        raise InputError(f"a path has {len(x_mm)} points, expected at least {FEWEST}")
    circle = least_squares_circle(x_mm, y_mm)
    if abs(circle.radius_mm - radius_mm) > WRONG_RADIUS * radius_mm:
        raise InputError(
            f"a path has a radius of {circle.radius_mm:g} mm where {radius_mm:g} mm is stated as nominal radius: a diameter?"
        )
    u, v = x_mm - circle.centre_mm[0], y_mm - circle.centre_mm[1]
    angle = np.degrees(np.unwrap(np.arctan2(v, u)))
    arc = float(angle[-1] - angle[0])
    widest = float(np.max(np.abs(np.diff(angle))))
    if abs(arc) < FULL_DEG or widest > WIDEST_GAP_DEG:
        raise InputError(
            f"a path covers {abs(arc):.1f}° with gaps up to {widest:.1f}°, expected at least {FULL_DEG:g}° without gaps over"
            f" {WIDEST_GAP_DEG:g}°"
        )
    away = np.hypot(u, v)
    deviation = (away - radius_mm) * UM_PER_MM
    start = float(angle[0] % 360.0)
    return CircularPath(
        *(1 if arc > 0 else -1, circle, start, start + arc),
        *(float(np.ptp(away)) * UM_PER_MM, float(deviation.max()), float(deviation.min())),
    )
