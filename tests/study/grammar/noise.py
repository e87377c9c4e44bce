"""Noise of an instrument on a machine, in several kinds, with the covariance that an observer who knows it would use.

Kinds: `white`; `heavy` (Student's t, or one row in twenty with four times the spread); `memory` (white and an
Ornstein–Uhlenbeck process within a run); `offsets` (white and an offset per run); `speed` (white that grows with the
speed); `mixed` (memory, offsets, speed at once).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from study.grammar.environment import Floats, State

KINDS = ("white", "heavy", "memory", "offsets", "speed", "mixed")


@dataclass(frozen=True)
class Noise:
    """Shares of the variance of a row at rest (white, memory, offset; sum 1), and what shapes the white part."""

    kind: str
    white: float
    memory: float
    offset: float
    memory_s: float = 60.0
    speed_factor: float = 0.0  # standard deviation at full speed: 1 + this
    degrees: float = 0.0  # of Student's t; 0: normal
    contaminated: bool = False
    scale_um: float = 1.0

    def _white_sd(self, state: State) -> Floats:
        fastest = state.axis.feeds_mm_s[-1]
        return np.asarray(np.sqrt(self.white) * (1.0 + self.speed_factor * np.abs(state.velocity_mm_s) / fastest))

    def sd_um(self, state: State) -> float:
        """Expected root mean square over the rows of a campaign."""
        return self.scale_um * float(np.sqrt(np.mean(self._white_sd(state) ** 2) + self.memory + self.offset))

    def covariance(self, state: State) -> Floats:
        """Covariance of the rows, µm², shape (n, n)."""
        same = state.run[:, None] == state.run[None, :]
        apart = np.abs(state.time_s[:, None] - state.time_s[None, :])
        matrix = same * (self.memory * np.exp(-apart / self.memory_s) + self.offset)
        return np.asarray(self.scale_um**2 * (matrix + np.diag(self._white_sd(state) ** 2)))

    def draw(self, rng: Generator, state: State) -> Floats:
        """One realisation, µm, shape (n,)."""
        n = len(state)
        white = rng.normal(size=n)
        if self.degrees:
            white = rng.standard_t(self.degrees, n) * np.sqrt((self.degrees - 2.0) / self.degrees)
        if self.contaminated:  # variance 0.95 + 0.05 · 16 = 1.75
            white = white * np.where(rng.random(n) < 0.05, 4.0, 1.0) / np.sqrt(1.75)
        values = white * self._white_sd(state)
        memory = np.zeros(n)
        for row in range(n):
            keep = 0.0
            if row and state.run[row] == state.run[row - 1]:
                keep = float(np.exp(-(state.time_s[row] - state.time_s[row - 1]) / self.memory_s))
            memory[row] = keep * (memory[row - 1] if row else 0.0) + np.sqrt(1.0 - keep**2) * rng.normal()
        values = values + np.sqrt(self.memory) * memory
        for run in np.unique(state.run):
            values = values + np.where(state.run == run, np.sqrt(self.offset) * rng.normal(), 0.0)
        return np.asarray(self.scale_um * values)


def draw_noise(rng: Generator, kind: str, scale_um: float) -> Noise:
    """A noise of one kind of `KINDS`. Raises KeyError for another."""
    memory = float(rng.uniform(0.15, 0.45))
    offset = float(rng.uniform(0.05, 0.25))
    memory_s = float(rng.choice([8.0, 20.0, 60.0, 150.0]))
    factor = float(rng.uniform(0.5, 2.0))
    heavy = bool(rng.random() < 0.5)
    degrees = float(rng.uniform(3.0, 6.0))
    made = {
        "white": Noise(kind, 1.0, 0.0, 0.0),
        "heavy": Noise(kind, 1.0, 0.0, 0.0, degrees=degrees if heavy else 0.0, contaminated=not heavy),
        "memory": Noise(kind, 1.0 - memory, memory, 0.0, memory_s=memory_s),
        "offsets": Noise(kind, 1.0 - offset, 0.0, offset),
        "speed": Noise(kind, 1.0, 0.0, 0.0, speed_factor=factor),
        "mixed": Noise(kind, 1.0 - 0.5 * (memory + offset), 0.5 * memory, 0.5 * offset, memory_s, 0.5 * factor),
    }[kind]
    return scaled(made, scale_um)


def scaled(noise: Noise, scale_um: float) -> Noise:
    """The same noise with another scale."""
    return Noise(**{**noise.__dict__, "scale_um": scale_um})
