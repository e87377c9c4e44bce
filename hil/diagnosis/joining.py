"""Campaigns one after another as one, and rows split again by the sensors that were there."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from hil.effects.history import complete
from hil.records.rows import Records, concatenate

SET = {"load_kg": 1.0, "pos_y_mm": 100.0, "abbe_offset_mm": 0.0, "setup": 1.0}
"""Columns that a person sets, with the level assumed where none is recorded."""
SENSED = re.compile(r"temp_\w+_c|air_\w+|pitch_urad|yaw_urad")


def is_set(column: str) -> bool:
    """Whether a column is set by a person, not read."""
    return column in SET or bool(re.fullmatch(r"pos_\w+_mm", column))


def joined(parts: Sequence[Records]) -> Records:
    """Campaigns one after another as one; a set column without values had the first level of a later campaign.

    A sensor that was missing leaves its cells empty. Raises InputError as `Records.of`.
    """
    columns = dict.fromkeys(name for part in parts for name in part.columns)
    usual = {name: next(float(p[name][0]) for p in parts if name in p) for name in columns if is_set(name)}
    usual |= {name: value for name, value in (("abbe_offset_mm", 0.0), ("setup", 1.0)) if name in usual}
    timed = all("time_s" in part for part in parts)
    whole = []
    for part in parts:
        full = dict(part.columns)
        if "since_reversal_mm" in columns or "stroke_mm" in columns:
            full |= {name: v for name, v in complete(full).items() if name in ("since_reversal_mm", "stroke_mm")}
        for name in columns:
            if name not in full:
                rest = part.command_mm if name == "command_mm" else np.full(len(part), usual.get(name, math.nan))
                full[name] = np.zeros(len(part)) if name == "velocity_mm_s" else rest
        if not timed:
            full.pop("time_s", None)
        whole.append(Records.of(full))
    return concatenate(whole)


def segments(records: Records) -> tuple[Records, ...]:
    """The records split by which sensors were there, each without its empty columns."""
    sensors = [name for name in records.columns if SENSED.fullmatch(name)]
    there = np.array([np.isfinite(records[name]) for name in sensors]).reshape(len(sensors), len(records))
    kinds = np.unique(there, axis=1)
    parts = []
    for kind in kinds.T:
        rows = np.all(there == kind[:, None], axis=0)
        gone = {name for name, filled in zip(sensors, kind, strict=True) if not filled}
        part = records.where(rows)
        parts.append(
            (int(np.flatnonzero(rows)[0]), Records.of({n: v for n, v in part.columns.items() if n not in gone}))
        )
    return tuple(part for _, part in sorted(parts, key=lambda item: item[0]))
