"""Which names of the catalogue are right for which cause of this study, with the reason.

The catalogue's names (`support.catalogue`) and meanings are those of the documented output of `hil diagnose`. `RIGHT`: naming it is
naming the cause. `WITHOUT_COLUMN`: right as well where the column that tells the two apart was not logged. `POINTS_AT`: not right,
since the form is outside the catalogue, but no wrong name either: it points at the quantity that carries the cause.
"""

from __future__ import annotations

from collections.abc import Mapping

from study.grammar.physics import Cause

RIGHT: Mapping[str, Mapping[str, str]] = {
    "expansion": {"thermal_expansion": "grows with position and temperature, about whatever point is fixed"},
    "drift": {"thermal_drift": "an offset that follows a temperature"},
    "settling": {"thermal_drift": "an offset that settles with time"},
    "air": {"air_index": "air index times position; the origin of the length is the set-up's"},
    "dead_air": {"dead_path": "air index times a fixed path"},
    "reversal_along": {"backlash_position": "the reversal value varies along the axis"},
    "wind_up": {"lost_motion": "comes after a reversal, over a distance, whatever the form of the rise"},
    "lag": {"velocity_lag": "grows with velocity; a power of 0.85 to 1.15 is the same cause"},
    "load": {"load_deflection": "load or torque"},
    "cycle": {"cyclic": "repeats with a period of the travel"},
    "cross": {"cross_axis": "another axis's position"},
    "arm": {"abbe": "angle times arm, pitch or yaw"},
    "slip": {"datum_step": "a jump at one moment"},
    "wear": {"local_wear": "a zone, in one or both directions"},
    "shape": {"pitch_shape": "a smooth shape that the table missed"},
    "wander": {"beam_drift": "an offset that wanders with time and nothing else"},
}

ALSO_RIGHT: Mapping[tuple[str, str], Mapping[str, str]] = {
    ("wear", "in reversal"): {
        "backlash_position": "wear that opens the reversal value in a zone makes it vary along the axis"
    },
    ("reversal_along", "worn"): {"local_wear": "a reversal value that is larger around one place is a worn zone"},
}
"""By cause and family: two names of the catalogue describe the same physical cause."""

WITH_A_MEAN = ("bow", "worn", "wave")
"""Reversal values along the axis whose mean over the travel is not zero: a constant one is a part of them."""

_UNSEEN = "with no column for it the rows hold an offset that wanders with time and nothing else"
WITHOUT_COLUMN: Mapping[str, Mapping[str, str]] = {
    "drift": {"beam_drift": _UNSEEN},
    "settling": {"beam_drift": _UNSEEN},
    "dead_air": {"beam_drift": _UNSEEN},
}

ALWAYS_THERE: Mapping[str, str] = {
    "backlash": "every machine here has a constant reversal value",
    "cosine": "every machine here has a lead error, which a misaligned beam cannot be told from",
}

POINTS_AT: Mapping[str, str] = {
    "time_s": "beam_drift",
    "load_kg": "load_deflection",
    "velocity_mm_s": "velocity_lag",
    "since_reversal_mm": "lost_motion",
    "pitch_urad": "abbe",
    "pos_y_mm": "cross_axis",
    "pos_z_mm": "cross_axis",
    "air_pressure_hpa": "dead_path",
    "air_temp_c": "dead_path",
}
"""For a cause that is a form of one column, alone or with the direction; temperatures point at `thermal_drift`."""


def right_names(cause: Cause, removed: tuple[str, ...], course_of_time: bool) -> frozenset[str]:
    """Names that name this cause; none for one from outside, unless it is a course of time on these rows (`course_of_time`)."""
    if cause.name == "outside":
        hidden_alone = cause.family == "hidden" and cause.columns == ("time_s",) and "direction" not in cause.text
        return frozenset(
            {"beam_drift"} if course_of_time or hidden_alone else ()
        )  # "wanders with time and nothing else"
    names = {*RIGHT[cause.name], *ALSO_RIGHT.get((cause.name, cause.family), ())}
    if removed:
        names |= set(WITHOUT_COLUMN.get(cause.name, ()))
    return frozenset(names)


def not_wrong(cause: Cause) -> frozenset[str]:
    """Names that are not right for a cause and not wrong either."""
    if cause.name == "reversal_along" and cause.family in WITH_A_MEAN:
        return frozenset({"backlash"})
    if cause.name != "outside" or cause.family not in ("alone", "with direction", "hidden") or len(cause.columns) != 1:
        return frozenset()
    column = cause.columns[0]
    slow = column.startswith(("temp_", "air_"))
    found = {POINTS_AT[column]} if column in POINTS_AT else set()
    if column.startswith("temp_"):
        found.add("thermal_drift")
    if slow and cause.family == "alone":
        found.add("beam_drift")  # one campaign shows such a column as a course of time
    return frozenset(found)


def true_parameters(cause: Cause) -> dict[str, dict[str, float]]:
    """True values of parameters as the diagnosis states them, by effect; only where the cause has the catalogue's own form."""
    size = cause.amplitude
    if cause.name == "expansion" and not cause.constants["uneven"]:
        return {"thermal_expansion": {"coefficient_ppm_per_k": size}}
    if cause.name == "lag" and cause.constants["power"] == 1.0:
        return {"velocity_lag": {"lag_ms": -size}}  # µm per mm/s is ms; a positive one is ahead
    return {
        "cycle": {"cyclic": {"period_mm": cause.constants.get("period_mm", 0.0)}},
        "drift": {"thermal_drift": {"coefficient_um_per_k": size}},
        "arm": {"abbe": {"arm_mm": size}},
        "slip": {"datum_step": {"step_um": size}},
        "dead_air": {"dead_path": {"dead_path_mm": 1000.0 * size}},
    }.get(cause.name, {})


def always_there(older_table: bool) -> frozenset[str]:
    """Names that are never wrong on these machines; an older table has taken both out."""
    return frozenset() if older_table else frozenset(ALWAYS_THERE)
