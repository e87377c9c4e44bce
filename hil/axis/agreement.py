"""How far instrument and motor may disagree on one travel: what `[instrument]` and `[axis]` say, and the defaults."""

from __future__ import annotations

from dataclasses import dataclass

WITHIN_UM = 500.0
"""Largest difference of the two travels, µm: several times the Abbe, thermal and wind-up errors of a feed axis, which tests by
ISO 230-2 and 230-3 find in tens of µm."""
REVERSAL_UM = 200.0
"""Largest reversal, µm: four times the 50 µm of a worn ball screw, and what rack and pinion drives are set to (0.1 to 0.2 mm)."""
LATEST_S = 0.1
"""From a sample to its arrival where the axis file states no latency_s: more than displays and gauges on a serial line take."""
DATED_WITHIN_S = 0.05
"""What a moment of a motor position or an arrival may be off on a busy host or a slow fieldbus."""
STEADY_SHARE = 0.1
"""Of `within_um`, by which `reading - motor` may change within a second of a motor that stands, and besides what travel and reversal
explain from one rest to the next: 50 µm, above errors that repeat with a lead (5 µm), the noise of a display, a load that settles."""


@dataclass(frozen=True)
class AgreementLimits:
    """What the axis file allows. within_um, largest_reversal_um: see above; latency_s: of the instrument, None: not known."""

    within_um: float = WITHIN_UM
    largest_reversal_um: float = REVERSAL_UM
    latency_s: float | None = None

    @property
    def slack_mm(self) -> float:
        """What the two travels may differ by, however short: within a reversal the load may wait."""
        return (self.within_um + self.largest_reversal_um) / 1000.0

    @property
    def steady_mm(self) -> float:
        """What they may differ by more at a rest than a second or one motion before."""
        return STEADY_SHARE * self.within_um / 1000.0

    @property
    def lags_s(self) -> tuple[float, float]:
        """How long before its arrival a sample was taken, at least and at most."""
        if self.latency_s is None:
            return -DATED_WITHIN_S, LATEST_S + DATED_WITHIN_S
        return self.latency_s - DATED_WITHIN_S, self.latency_s + DATED_WITHIN_S
