"""The figures of ISO 230-2:2014 for a linear axis, as pure functions over measurement records.

Deviation of one approach: x_ij = measured - target (the error as it was measured, with whatever correction was in
force; the command is not used, so records of a corrected axis give the figures of the corrected axis). Arrow up is
direction +1, arrow down is direction -1. Every length in an `Iso230` is in µm except the targets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from drivers.errors import InputError
from hil.figures import FIGURES
from hil.records.rows import Floats, Records

MEASURED_AT_A_REVERSAL: Mapping[str, str] = MappingProxyType(
    {
        "B": "reversal value B: what the instrument reads at rest, corrected: mean of direction + less mean of direction − at one"
        " target, each after a run past it; the largest of all targets",
        "backlash": "measured here: travel of the motor from a turn until its torque has risen to that of sliding, without an"
        " instrument; it lacks what the load still lags behind then",
        "lost_motion": "measured here: by the instrument, uncorrected, the error of a place soon after a turn less that after a"
        " whole stroke; the amount is that after the longest travel",
    }
)
"""What each of the three figures of a reversal measures. They differ on one axis, and none of them is wrong."""

OTHER_REVERSAL_FIGURES = "backlash, lost motion and B are three quantities: hil help reading_the_figures"

TARGET_RESOLUTION_MM = 1e-6
"""Targets closer than this are the same target (far below any instrument, far above float64 noise at 10 m)."""


@dataclass(frozen=True)
class Iso230:
    """ISO 230-2 figures of one campaign. All in µm, but for target_mm.

    m targets, n runs per direction. Arrays have shape (m,) in ascending order of target. A figure is None where the campaign
    cannot give it: everything about the other direction in a one-directional campaign, everything that needs a standard
    deviation (s, R, A) in a campaign of one run. `notes` says in words what is missing or short of the standard.
    """

    m: int
    n: int
    target_mm: Floats
    mean_up: Floats | None
    mean_down: Floats | None
    s_up: Floats | None
    s_down: Floats | None
    B_i: Floats | None
    R_up_i: Floats | None
    R_down_i: Floats | None
    R_i: Floats | None
    B: float | None
    B_mean: float | None
    M: float | None
    E_up: float | None
    E_down: float | None
    E: float | None
    R_up: float | None
    R_down: float | None
    R: float | None
    A_up: float | None
    A_down: float | None
    A: float | None
    notes: tuple[str, ...] = ()

    @property
    def mean(self) -> Floats | None:
        """Mean bi-directional deviation of each target, shape (m,), None for one direction."""
        return None if self.mean_up is None or self.mean_down is None else (self.mean_up + self.mean_down) / 2

    def figures(self) -> dict[str, float | None]:
        """The axis figures by name, in the order of `FIGURES`, µm."""
        return {name: getattr(self, name) for name in FIGURES}

    def curves(self) -> dict[str, tuple[Floats, ...]]:
        """Each axis figure that there is, but for the mean B̄, as curves of shape (m,): it is the sum of their highest values, µm."""
        found: dict[str, tuple[Floats, ...]] = {}
        for name, mean, s in (("up", self.mean_up, self.s_up), ("down", self.mean_down, self.s_down)):
            if mean is not None:
                found[f"E_{name}"] = (mean, -mean)
            if mean is not None and s is not None:
                found[f"A_{name}"] = (mean + 2 * s, 2 * s - mean)
        for name in ("A", "E"):
            up, down = found.get(f"{name}_up"), found.get(f"{name}_down")
            if up is not None and down is not None:
                found[name] = (np.maximum(up[0], down[0]), np.maximum(up[1], down[1]))
        if self.mean is not None and self.B_i is not None:
            found |= {"M": (self.mean, -self.mean), "B": (np.abs(self.B_i),)}
        for name, R in (("R", self.R_i), ("R_up", self.R_up_i), ("R_down", self.R_down_i)):
            if R is not None:
                found[name] = (R,)
        return found

    def as_json(self) -> dict[str, object]:
        """Plain JSON form: m, n, figures_um by name, one entry per target, notes."""
        columns = {
            "mean_up_um": self.mean_up,
            "mean_down_um": self.mean_down,
            "s_up_um": self.s_up,
            "s_down_um": self.s_down,
            "B_um": self.B_i,
            "R_up_um": self.R_up_i,
            "R_down_um": self.R_down_i,
            "R_um": self.R_i,
        }
        targets = [
            {"target_mm": float(self.target_mm[i]), **{name: _at(values, i) for name, values in columns.items()}}
            for i in range(self.m)
        ]
        return {
            "standard": "ISO 230-2:2014",
            "m": self.m,
            "n": self.n,
            "figures_um": self.figures(),
            "targets": targets,
            "notes": list(self.notes),
        }


def symbol(name: str) -> str:
    """The symbol of a figure, such as "R↑" for "R_up"."""
    return "B̄" if name == "B_mean" else name.replace("_up", "↑").replace("_down", "↓")


def iso230(records: Records) -> Iso230:
    """The figures of ISO 230-2:2014, clauses 3 and 7, of one campaign.

    Raises InputError when the standard's formulas do not apply to the campaign: fewer than two targets, a target
    approached unequally often or twice in one run, a target approached from one direction while others have both.
    """
    deviation = {sign: _deviations(records, sign) for sign in (1, -1) if np.any(records.direction == sign)}
    _check_design(deviation)
    target_mm = np.array(list(next(iter(deviation.values()))), dtype=np.float64)
    m = len(target_mm)
    if m < 2:
        raise InputError(f"records hold {m} target, expected at least 2 (ISO 230-2 asks for 5 or more)")
    runs = {sign: np.array(list(found.values()), dtype=np.float64) for sign, found in deviation.items()}
    n = next(iter(runs.values())).shape[1]

    mean = {sign: x.mean(axis=1) for sign, x in runs.items()}
    s = {sign: x.std(axis=1, ddof=1) for sign, x in runs.items()} if n > 1 else {}
    both = len(runs) == 2
    B_i = mean[1] - mean[-1] if both else None
    R_one = {sign: 4 * spread for sign, spread in s.items()}
    R_i = None
    if B_i is not None and s:
        R_i = np.maximum.reduce([2 * s[1] + 2 * s[-1] + np.abs(B_i), R_one[1], R_one[-1]])
    mean_both = (mean[1] + mean[-1]) / 2 if both else None

    return Iso230(
        m=m,
        n=n,
        target_mm=target_mm,
        mean_up=mean.get(1),
        mean_down=mean.get(-1),
        s_up=s.get(1),
        s_down=s.get(-1),
        B_i=B_i,
        R_up_i=R_one.get(1),
        R_down_i=R_one.get(-1),
        R_i=R_i,
        B=None if B_i is None else float(np.max(np.abs(B_i))),
        B_mean=None if B_i is None else float(np.mean(B_i)),
        M=None if mean_both is None else _range(mean_both),
        E_up=_range(mean[1]) if 1 in mean else None,
        E_down=_range(mean[-1]) if -1 in mean else None,
        E=_range(np.concatenate([mean[1], mean[-1]])) if both else None,
        R_up=_max(R_one.get(1)),
        R_down=_max(R_one.get(-1)),
        R=_max(R_i),
        A_up=_accuracy(mean, s, (1,)),
        A_down=_accuracy(mean, s, (-1,)),
        A=_accuracy(mean, s, (1, -1)),
        notes=_notes(records, target_mm, n, tuple(runs)),
    )


def _deviations(records: Records, sign: int) -> dict[float, list[float]]:
    """Deviations in µm by target in mm, ascending, of one direction; one value per run, in the order of time."""
    found: dict[int, list[float]] = {}
    nominal_mm: dict[int, float] = {}
    seen: set[tuple[int, int]] = set()
    here = records.direction == sign
    for run, target, error in zip(records.run[here], records.target_mm[here], records.error_um[here], strict=True):
        key = round(float(target) / TARGET_RESOLUTION_MM)
        if (int(run), key) in seen:
            raise InputError(
                f"run {int(run)} holds target {target:g} mm in direction {sign:+d} twice, expected one row per approach"
            )
        seen.add((int(run), key))
        nominal_mm.setdefault(key, float(target))
        found.setdefault(key, []).append(float(error))
    return {nominal_mm[key]: found[key] for key in sorted(found)}


def _check_design(deviation: Mapping[int, Mapping[float, list[float]]]) -> None:
    counts = {
        (round(target / TARGET_RESOLUTION_MM), sign): (target, len(values))
        for sign, found in deviation.items()
        for target, values in found.items()
    }
    for (key, sign), (target, _) in sorted(counts.items()):
        if len(deviation) == 2 and (key, -sign) not in counts:
            raise InputError(
                f"target {target:g} mm was measured in direction {sign:+d} only, expected both directions as at the others"
            )
    by_count: dict[int, list[tuple[float, int]]] = {}
    for (_, sign), (target, count) in counts.items():
        by_count.setdefault(count, []).append((target, sign))
    if len(by_count) > 1:
        usual = max(by_count, key=lambda count: len(by_count[count]))
        odd = next(count for count in sorted(by_count) if count != usual)
        target, sign = min(by_count[odd])
        raise InputError(
            f"target {target:g} mm has {odd} run(s) in direction {sign:+d}, expected {usual} as at the other targets"
        )


def _range(values: Floats) -> float:
    return float(np.max(values) - np.min(values))


def _at(values: Floats | None, i: int) -> float | None:
    return None if values is None else float(values[i])


def _max(values: Floats | None) -> float | None:
    return None if values is None else float(np.max(values))


def _accuracy(mean: Mapping[int, Floats], s: Mapping[int, Floats], signs: tuple[int, ...]) -> float | None:
    if any(sign not in s for sign in signs):
        return None
    upper = max(float(np.max(mean[sign] + 2 * s[sign])) for sign in signs)
    lower = min(float(np.min(mean[sign] - 2 * s[sign])) for sign in signs)
    return upper - lower


def _notes(records: Records, target_mm: Floats, n: int, signs: tuple[int, ...]) -> tuple[str, ...]:
    """Departures of the campaign from clause 5.3 of the standard."""
    notes = []
    m = len(target_mm)
    travel_mm = float(target_mm[-1] - target_mm[0])
    if len(signs) == 1:
        notes.append(f"measured in direction {signs[0]:+d} only: no reversal value, no bi-directional figure")
    if n == 1:
        notes.append(
            "one run: the standard deviation is undefined, so repeatability (R) and accuracy (A) are not given"
        )
    elif n < 5 and travel_mm <= 2000:
        notes.append(f"{n} runs per direction; the standard asks for five on axes up to 2 m")
    needed = max(5, int(np.ceil(travel_mm / 200))) if travel_mm <= 2000 else int(np.ceil(travel_mm / 250)) + 1
    if m < needed:
        notes.append(f"{m} targets over {travel_mm:g} mm; the standard asks for at least {needed}")
    spacing = np.diff(target_mm)
    if m > 2 and float(np.ptp(spacing)) < 1e-3 * float(np.mean(spacing)):
        notes.append(
            f"targets are evenly spaced ({float(np.mean(spacing)):g} mm): a cyclic error whose period divides the spacing "
            "stays hidden; the standard adds a random offset to each target"
        )
    if "velocity_mm_s" in records:
        moving = np.abs(np.nan_to_num(records["velocity_mm_s"]))
        if np.any(moving > 0):
            notes.append(
                f"{int(np.sum(moving > 0))} row(s) were captured in motion (up to {float(np.max(moving)):g} mm/s); "
                "the standard measures at rest"
            )
    return tuple(notes)
