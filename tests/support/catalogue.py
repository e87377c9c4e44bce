"""The names of the catalogue of effects, as `hil diagnose` writes them and users of its JSON rely on them.

Written out here, not taken from `hil.effects` or from the switches of the simulated machine: both are held against this list.
"""

from __future__ import annotations

NEVER_COMPENSATED = frozenset({"datum_step", "dead_path", "air_index", "cosine", "beam_drift"})
NAMES = NEVER_COMPENSATED | {
    "cyclic",
    "thermal_expansion",
    "thermal_drift",
    "backlash",
    "backlash_position",
    "lost_motion",
    "velocity_lag",
    "load_deflection",
    "abbe",
    "cross_axis",
    "local_wear",
    "pitch_shape",
}
