"""The drive train between motor and table: two springs, the screw's own friction, and a table that sticks, breaks away and slides.

The motor's shaft turns the screw through the coupling (first spring), the screw pushes the table through nut and bearings (second
spring, stiffer under load, with a clearance if there is one). Friction of both bodies follows the LuGre law (Canudas de Wit
et al., IEEE Trans. Autom. Control 40 (1995) 419): bristles that bend before anything slides, a Stribeck curve, viscous damping. The
The table's static excess is a bond that sliding breaks and rest restores, so that a break-away depends on history and not on speed
alone. Masses are neglected: the bodies are overdamped, as in a feed axis at the speeds where its friction matters.

Units within: µm of nominal travel, N at the table, s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

SUBSTEP_S, SUBSTEP_UM = 0.00025, 0.1
"""Shortest substep, s, and largest motion of the motor in one, µm, where the first allows it."""
LONGEST_S = 0.005
_MOST_SUBSTEPS = 400
_AT_REST_UM_S = 1e-3


@dataclass(frozen=True)
class Guide:
    """Friction of the table on its guideway.

    sliding_n: at low speed and broken bonds, per_kg_n more for each kg of load; static_excess: how much more it takes to break away
    after a long rest, relative; bond_um: slip over which a bond falls to 1/e; heal_s: rest over which it recovers by as much;
    stribeck_mm_s: speed at which the excess is gone whatever the bond; bristle_n_per_um: stiffness before sliding.
    """

    sliding_n: float = 800.0
    per_kg_n: float = 0.0
    static_excess: float = 0.06
    bond_um: float = 2.0
    heal_s: float = 2.0
    stribeck_mm_s: float = 4.0
    bristle_n_per_um: float = 12000.0
    viscous_n_s_per_mm: float = 15.0


@dataclass(frozen=True)
class DriveTrain:
    """The two springs and the frictions. hardening_per_um: relative growth of the second spring's stiffness per µm of its deflection;
    rated_n: force at the table at the motor's rated torque, N; weight_n: weight that acts along a vertical axis, N."""

    coupling_n_per_um: float = 120.0
    nut_n_per_um: float = 39.51
    hardening_per_um: float = 0.004
    gap_um: float = 0.0
    screw_friction_n: float = 120.0
    screw_bristle_n_per_um: float = 3000.0
    screw_viscous_n_s_per_mm: float = 6.0
    guide: Guide = Guide()
    rated_n: float = 10_000.0
    weight_n: float = 0.0


class WindUp:
    """A drive train with its state: positions of screw and table, and deflection of the bristles of both."""

    def __init__(self, train: DriveTrain, motor_mm: float) -> None:
        self.train = train
        self.motor_um = self._screw_um = self.table_um = motor_mm * 1000.0
        self._screw_bristle_um = 0.0
        self._table_bristle_um = 0.0
        self._bond = 1.0
        self._settled = True

    @property
    def lag_um(self) -> float:
        """Lag of the table behind the motor, µm, with the sign of the motion before."""
        return self.motor_um - self.table_um

    @property
    def torque_permille(self) -> float:
        """Torque of the first spring on the motor, 0.1 % of rated."""
        train = self.train
        return 1000.0 * train.coupling_n_per_um * (self.motor_um - self._screw_um) / train.rated_n

    def step(self, motor_mm: float, dt_s: float, load_kg: float) -> None:
        """Move the motor to `motor_mm` at constant velocity within dt_s seconds."""
        start_um, end_um = self.motor_um, motor_mm * 1000.0
        if end_um == start_um and self._settled:
            self._bond = 1.0 - (1.0 - self._bond) * math.exp(-dt_s / self.train.guide.heal_s)
            return
        count, h_s = _substeps(abs(end_um - start_um), dt_s)
        sliding_n = self.train.guide.sliding_n + self.train.guide.per_kg_n * load_kg
        fastest = 0.0
        for index in range(1, count + 1):
            self.motor_um = start_um + (end_um - start_um) * index / count
            fastest = max(abs(self._move_screw(h_s)), abs(self._move_table(h_s, sliding_n)))
        self.motor_um = end_um
        self._settled = end_um == start_um and (fastest < _AT_REST_UM_S or count == _MOST_SUBSTEPS)

    def _nut(self) -> tuple[float, float]:
        """Force of the second spring, N, and its present stiffness, N/µm."""
        train = self.train
        stretch = self._screw_um - self.table_um
        size = abs(stretch) - 0.5 * train.gap_um
        if size <= 0.0:
            return 0.0, 0.0
        force = train.nut_n_per_um * size * (1.0 + train.hardening_per_um * size)
        stiffness = train.nut_n_per_um * (1.0 + 2.0 * train.hardening_per_um * size)
        return math.copysign(force, stretch), stiffness

    def _move_screw(self, h_s: float) -> float:
        """One substep of h_s seconds of the screw; its speed, µm/s. Linearly implicit, so that stiff bristles allow longer steps."""
        train = self.train
        force, stiffness = self._nut()
        bristle = train.screw_bristle_n_per_um
        net = train.coupling_n_per_um * (self.motor_um - self._screw_um) - force - bristle * self._screw_bristle_um
        bend = _bending(self._screw_bristle_um * bristle / train.screw_friction_n, net)
        damping = train.screw_viscous_n_s_per_mm / 1000.0
        speed = net / (damping + h_s * (train.coupling_n_per_um + stiffness + bristle * bend))
        moved = speed * h_s
        self._screw_um += moved
        self._screw_bristle_um = _bent(self._screw_bristle_um, moved, train.screw_friction_n / bristle)
        return speed

    def _move_table(self, h_s: float, sliding_n: float) -> float:
        guide = self.train.guide
        force, stiffness = self._nut()
        bristle = guide.bristle_n_per_um
        net = force - bristle * self._table_bristle_um - self.train.weight_n
        static_n = sliding_n * (1.0 + guide.static_excess * self._bond)
        bend = _bending(self._table_bristle_um * bristle / static_n, net)
        speed = net / (guide.viscous_n_s_per_mm / 1000.0 + h_s * (stiffness + bristle * bend))
        moved = speed * h_s
        self.table_um += moved
        stribeck = math.exp(-((speed / (1000.0 * guide.stribeck_mm_s)) ** 2))
        friction_n = sliding_n * (1.0 + guide.static_excess * self._bond * stribeck)
        before = self._table_bristle_um
        self._table_bristle_um = _bent(before, moved, friction_n / bristle)
        slipped = abs(moved - (self._table_bristle_um - before))
        self._bond *= math.exp(-slipped / guide.bond_um)
        self._bond += (1.0 - self._bond) * h_s / guide.heal_s
        return speed


def _substeps(travel_um: float, dt_s: float) -> tuple[int, float]:
    """(number, length in s) of the substeps: short enough for the motion and for the settling of the bodies.

    At rest a long time is cut short: after `_MOST_SUBSTEPS` no motion is left.
    """
    least = math.ceil(dt_s / LONGEST_S)
    most = math.ceil(dt_s / SUBSTEP_S)
    count = max(1, least, min(most, math.ceil(travel_um / SUBSTEP_UM)))
    if count <= _MOST_SUBSTEPS or travel_um:
        return count, dt_s / count
    return _MOST_SUBSTEPS, LONGEST_S


def _bending(share: float, net: float) -> float:
    """Share of a motion under a net force that bends the bristles further: 1 straight, 0 at their largest deflection."""
    along = share if net > 0.0 else -share
    return min(2.0, max(0.0, 1.0 - along))


def _bent(bristle_um: float, moved_um: float, most_um: float) -> float:
    """Deflection of the bristles after a motion, µm: exact for a constant speed within it."""
    if moved_um == 0.0:
        return bristle_um
    end = math.copysign(most_um, moved_um)
    return end + (bristle_um - end) * math.exp(-abs(moved_um) / most_um)
