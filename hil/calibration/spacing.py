"""The error between the targets of a table: measured by one dense pass of the uncorrected axis, and expected for any spacing.

A table is linear between its targets. What it leaves there is the error's curvature, h²/8 · f″ for a spacing h, and the cyclic error
of screw or scale, which stays whole where h is not well below its period. The pass has two stretches of two screw revolutions each,
for the cyclic part, and points over the whole travel, for the shape. Fitted are two harmonics of the revolution and a cubic spline.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.errors import InputError
from hil.axis.axis_file import AxisConfig, iso_targets
from hil.machine.measure import Step
from hil.records.rows import Floats, Records

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

KIND = "dense"
OVER_TRAVEL, PER_REVOLUTION, REVOLUTIONS = 60, 10, 2
"""Points over the whole travel; in each dense stretch, points per revolution (five per period of the second
harmonic) and revolutions."""
STRETCHES = (0.2, 0.7)
"""Where the dense stretches begin, as shares of the travel."""
KNOTS = 15
"""Inner knots of the spline, a quarter of the points over the travel: a shape of shorter wave is noise to it."""
HARMONICS = (1, 2)
FINE_POINTS = 20_000
"""Points at which the left error is evaluated; a screw of 5 mm over 2 m has 50 in each revolution."""
MOST_SECTIONS = 400
"""No finer table is proposed: at 2 s a position, both ways and five runs, that is more than two hours."""
SETTLED_SHARE = 0.05
"""Without a limit that many sections are proposed beyond which doubling them takes less than this share off the expected A."""


@dataclass(frozen=True)
class Expected:
    """Expected at other targets for one number of sections, µm. E_um: range of what the table leaves; A_um: with the scatter."""

    sections: int
    spacing_mm: float
    E_um: float
    A_um: float


@dataclass(frozen=True)
class Between:
    """The error along the axis as the dense pass shows it.

    cyclic: cosine and sine of each harmonic, µm, shape (2, 2); shape: the rest; scatter_um: standard deviation about both
    """

    period_mm: float
    cyclic: Floats
    shape: BSpline
    scatter_um: float
    low_mm: float
    high_mm: float

    @property
    def amplitude_um(self) -> float:
        """Of the first harmonic, µm."""
        return float(np.hypot(*self.cyclic[0]))

    @property
    def amplitude_std_um(self) -> float:
        """Its standard uncertainty by the scatter, µm: √(2/n) of it for n points."""
        return self.scatter_um * math.sqrt(2.0 / (len(STRETCHES) * PER_REVOLUTION * REVOLUTIONS + OVER_TRAVEL))

    def error_um(self, position_mm: Floats) -> Floats:
        """The fitted error at positions, µm, shape as given."""
        cyclic = np.concatenate([self.cyclic[:, 0], self.cyclic[:, 1]])
        return np.asarray(self.shape(position_mm) + _harmonics(position_mm, self.period_mm) @ cyclic)

    def expected(self, targets_mm: Sequence[float]) -> Expected:
        """What a table made at these targets leaves between them."""
        nodes = np.asarray(targets_mm)
        fine = np.linspace(nodes[0], nodes[-1], FINE_POINTS)
        left = self.error_um(fine) - np.interp(fine, nodes, self.error_um(nodes))
        spread = float(np.ptp(left))
        spacing = float(np.mean(np.diff(nodes)))
        return Expected(len(nodes), spacing, spread, spread + 4.0 * self.scatter_um)


@dataclass(frozen=True)
class Proposal:
    """now: expected with the axis file's targets; proposed: with as many sections as are enough, None where no table is
    limit_um: what it is to reach, None without one
    """

    between: Between
    now: Expected
    proposed: Expected | None
    limit_um: float | None

    def sentences(self) -> tuple[str, ...]:
        cyclic, now = self.between, self.now
        amplitude = f"{cyclic.amplitude_um:.2f} ± {2.0 * cyclic.amplitude_std_um:.2f} µm"
        lines = [
            f"cyclic error: {amplitude} (k = 2) once per {cyclic.period_mm:g} mm of travel",
            f"expected anywhere between the targets, while no temperature changes: A up to {now.A_um:.1f} µm with"
            f" {now.sections} sections {now.spacing_mm:.1f} mm apart, as in the axis file",
        ]
        goal = "where more change little" if self.limit_um is None else f"for the limit of {self.limit_um:g} µm"
        if self.proposed is None:
            lines.append(
                f"no table of up to {MOST_SECTIONS} sections is enough {goal}: hil close-loop corrects a cyclic error as such"
            )
        elif self.proposed.sections == now.sections:
            lines.append(f"proposed {goal}: these sections")
        else:
            to = self.proposed
            lines.append(
                f"proposed {goal}: sections = {to.sections} in [measurement], {to.spacing_mm:.1f} mm apart: A up to {to.A_um:.1f} µm"
            )
        return tuple(lines)

    def as_json(self) -> dict[str, Any]:
        """Plain values, µm and mm."""
        return {
            "cyclic_period_mm": self.between.period_mm,
            "cyclic_amplitude_um": self.between.amplitude_um,
            "cyclic_amplitude_std_um": self.between.amplitude_std_um,
            "scatter_um": self.between.scatter_um,
            "expected": vars(self.now),
            "proposed": None if self.proposed is None else vars(self.proposed),
        }


def dense_steps(axis: AxisConfig) -> list[Step]:
    """One pass in direction +. Raises InputError for a travel shorter than the dense stretches."""
    low, high = min(axis.measurement.targets_mm), max(axis.measurement.targets_mm)
    period = axis.scaling.feed_mm_per_shaft_rev
    length = period * REVOLUTIONS
    if high - low < 2.0 * len(STRETCHES) * length:
        raise InputError(
            f"the targets span {high - low:g} mm, expected at least {2.0 * len(STRETCHES) * length:g} mm for a dense pass"
        )
    grid = np.linspace(low, high, OVER_TRAVEL)
    offsets = np.random.default_rng(axis.measurement.seed).uniform(-0.3, 0.3, OVER_TRAVEL) * (grid[1] - grid[0])
    offsets[0] = offsets[-1] = 0.0
    count = PER_REVOLUTION * REVOLUTIONS
    stretches = [low + share * (high - low) + np.arange(count) * period / PER_REVOLUTION for share in STRETCHES]
    targets = np.unique(np.round(np.concatenate([grid + offsets, *stretches]), 3))
    return [Step(1, 1, float(target)) for target in targets]


def between_targets(records: Records, period_mm: float) -> Between:
    """The fit to a dense pass. records: uncorrected, in one direction; period_mm: of the screw. Raises InputError for too few rows."""
    from scipy import interpolate  # noqa: PLC0415  (a verb starts without it)

    position, error_um = records.target_mm, records.uncorrected_error_um
    order = np.argsort(position)
    position, error_um = position[order], error_um[order]
    low, high = float(position[0]), float(position[-1])
    inner = np.linspace(low, high, KNOTS + 2)[1:-1]
    knots = np.concatenate([[low] * 4, inner, [high] * 4])
    harmonics = _harmonics(position, period_mm)
    if len(position) < len(knots) + harmonics.shape[1]:
        raise InputError(f"{len(position)} rows, expected the dense pass")
    spline = interpolate.BSpline.design_matrix(position, knots, 3).toarray()
    basis = np.concatenate([spline, harmonics], axis=1)
    solved = np.linalg.lstsq(basis, error_um, rcond=None)[0]
    amplitudes = solved[spline.shape[1] :]
    left = error_um - basis @ solved
    scatter = math.sqrt(float(left @ left) / (len(position) - basis.shape[1]))
    shape = interpolate.make_lsq_spline(position, error_um - harmonics @ amplitudes, knots, 3)
    count = len(HARMONICS)
    return Between(period_mm, np.stack([amplitudes[:count], amplitudes[count:]], axis=1), shape, scatter, low, high)


def propose(axis: AxisConfig, records: Records) -> Proposal:
    """The spacing for the axis's limit from its dense pass. Raises what `between_targets` raises."""
    between = between_targets(records, axis.scaling.feed_mm_per_shaft_rev)
    how, limit_um = axis.measurement, axis.correction.accuracy_limit_um
    now = between.expected(how.targets_mm)
    ends = (min(how.targets_mm), max(how.targets_mm))
    tried = [now]
    while (limit_um is None or tried[-1].A_um > limit_um) and 2 * tried[-1].sections <= MOST_SECTIONS:
        targets = iso_targets(*ends, 2 * tried[-1].sections, 0.3, how.seed)
        tried.append(between.expected(targets))
        if limit_um is None and tried[-1].A_um > (1.0 - SETTLED_SHARE) * tried[-2].A_um:
            return Proposal(between, now, tried[-2], None)
    enough = limit_um is not None and tried[-1].A_um <= limit_um
    return Proposal(between, now, tried[-1] if enough or limit_um is None else None, limit_um)


def _harmonics(position_mm: Floats, period_mm: float) -> Floats:
    """Cosines, then sines, of the harmonics of the period, shape (n, 4)."""
    angle = 2.0 * np.pi * np.asarray(position_mm)[:, None] * np.array(HARMONICS) / period_mm
    return np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
