"""The simulated probe: a contact that depends on the positions of X, Y and the spindle, with disturbances from touch to touch.

The geometry is in `plant.touch_probe`. All random values are drawn once for each touch, so that the contact is a function of position
while a ball approaches.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field

from sim_backends.plant.touch_probe import Bore, Chip, Face, Solid, Stylus

CLEAR_MM = 0.01  # a touch is over when the ball is so far away that no disturbance could make it signal at once


@dataclass(frozen=True)
class ProbeParameters:
    """A probe and the bodies that it may touch; seeded.

    play_mm: largest displacement, at every turn of the spindle, of a tool that is not drawn in
    """

    stylus: Stylus = field(default_factory=Stylus)
    solids: tuple[Solid, ...] = ()
    chips: tuple[Chip, ...] = ()
    play_mm: float = 0.0
    seed: int = 1


class SimulatedProbe:
    """`closed` is the contact; `follow` sets the machine's present position."""

    def __init__(self, parameters: ProbeParameters) -> None:
        self.parameters = parameters
        self.touches = 0  # number begun so far
        self.deepest_mm = 0.0  # largest overtravel of the ball beyond its signal
        self._rng = random.Random(parameters.seed)
        self._play = (0.0, 0.0)
        self._angle_deg = math.nan
        self._touching = False
        self._clear_mm = CLEAR_MM + sum(chip.thickness_mm for chip in parameters.chips)
        self._draw()

    def _draw(self) -> None:
        """Draw the random values of the next touch."""
        p, rng = self.parameters, self._rng
        self._trigger_mm = p.stylus.pretravel_mm + rng.gauss(0.0, p.stylus.noise_mm)
        present = [chip for chip in p.chips if chip.first_touch <= self.touches <= chip.last_touch]
        self._between_mm = sum(chip.thickness_mm * (1.0 - chip.give * rng.random()) for chip in present)

    def pushed_mm(self, x_mm: float, y_mm: float, spindle_deg: float, z_mm: float = 0.0) -> float:
        """Overtravel of the ball beyond its signal at this position, mm; negative: no contact."""
        stylus = self.parameters.stylus
        x, y, z = stylus.ball_mm((x_mm, y_mm, z_mm), math.radians(spindle_deg))
        ball = (x + self._play[0], y + self._play[1], z)
        nearest = min((solid.clearance_mm(ball) for solid in self.parameters.solids), default=math.inf)
        return stylus.radius_mm + self._between_mm - nearest - self._trigger_mm

    def closed(self, x_mm: float, y_mm: float, spindle_deg: float, z_mm: float = 0.0) -> bool:
        """Whether the probe signals there (mm, degrees), in the touch in progress or the next one."""
        return self.pushed_mm(x_mm, y_mm, spindle_deg, z_mm) >= 0.0

    def follow(self, x_mm: float, y_mm: float, spindle_deg: float, z_mm: float = 0.0) -> bool:
        """Set the machine's present position (mm, degrees); whether the probe signals."""
        if abs(spindle_deg - self._angle_deg) > 1.0 or math.isnan(self._angle_deg):
            self._angle_deg = spindle_deg
            play = self.parameters.play_mm
            self._play = (self._rng.uniform(-play, play), self._rng.uniform(-play, play))
        pushed_mm = self.pushed_mm(x_mm, y_mm, spindle_deg, z_mm)
        self.deepest_mm = max(self.deepest_mm, pushed_mm)
        if pushed_mm >= 0.0 and not self._touching:
            self._touching = True
            self.touches += 1
        elif self._touching and pushed_mm - self._between_mm < -self._clear_mm:
            self._touching = False
            self._draw()
        return pushed_mm >= 0.0


def known_probe(
    seed: int,
    *,
    face_mm: float,
    face_y_mm: float,
    facing: int,
    tip_radius_mm: float,
    bore_mm: tuple[float, float] | None = None,
    bore_radius_mm: float = 10.0,
) -> ProbeParameters:
    """A probe with a random position in the spindle, in front of a block at its nominal position, to ±20 µm in the radius.

    bore_mm: nominal position of the bore; the true one is within ±0.3 mm of that.
    """
    rng = random.Random(seed)
    stylus = Stylus(
        radius_mm=tip_radius_mm + rng.uniform(-0.02, 0.02),
        offset_mm=(rng.uniform(-0.08, 0.08), rng.uniform(-0.08, 0.08)),
        pretravel_mm=0.0,
        noise_mm=rng.uniform(0.0, 0.0002),
    )
    face = Face(
        (face_mm, face_y_mm, 0.0),
        facing,
        tilt_z_rad=rng.uniform(-0.003, 0.003),
        tilt_y_rad=rng.uniform(-0.003, 0.003),
    )
    solids: tuple[Solid, ...] = (face,)
    if bore_mm is not None:
        centre = (bore_mm[0] + rng.uniform(-0.3, 0.3), bore_mm[1] + rng.uniform(-0.3, 0.3), 0.0)
        solids = (face, Bore(centre, bore_radius_mm))
    return ProbeParameters(stylus, solids, seed=rng.getrandbits(32))
