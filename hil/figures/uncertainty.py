"""Uncertainty of the figures of ISO 230-2: the contributions that ISO/TR 230-9 names for a linear axis, at k = 2. No
I/O.

Each is an expanded uncertainty in µm over the measured length L in m. A quantity known only by its range R has a
rectangular distribution: U = 2·R/(2√3), which the standards write as 0.6·R.

    device        certificate: a + b·L                              misalignment  0.3·R²/L, R the lateral play of the
    beam in mm
    temperature   0.6·α·L·R(θ), R(θ) of the temperature measured    expansion     0.6·ΔT·L·R(α), ΔT the distance from 20
    °C
    environment   0.6·E_VE, E_VE the range of a drift test over the time of a campaign

The first four stretch all positions alike: they count once in a range over positions and not at all in a reversal or
repeatability.
The environment acts on each of the n approaches; it widens every standard deviation, so there it adds up and does not
average out.
With U_L² the sum of the first four squared, and u = U_EVE:

    E↑ E↓ E: √(U_L² + 2u²/n)      M: √(U_L² + u²/n)      B: √(2u²/n)      B̄: √(2u²/(n·m))
    R↑ R↓: 2u                     R: √(4u² + 2u²/n)      A↑ A↓ A: √(U_E² + 4u²)

To the square of each that of the choice of targets is added, `hil.figures.target_choice`: a figure stands for the axis, and not for
the targets at which it happened to be measured. How the figures would change on another day is not included.

Against a limit they are decided by the rule of ISO 14253-1: `conformity`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from drivers.errors import InputError
from drivers.toml_types import NotNegative
from hil.figures import FIGURES, target_choice
from hil.figures.iso230 import Iso230
from hil.records.rows import Records

RECTANGULAR = 1.0 / math.sqrt(3.0)
"""Expanded uncertainty (k = 2) of a rectangular distribution of range 1."""
REFERENCE_C = 20.0
"""Reference temperature, ISO 1."""


@dataclass(frozen=True)
class UncertaintyInputs:
    """What is known of the instrument and the room.

    device_um, device_um_per_m: U = a + b·L of its certificate, k = 2; misalignment_mm: lateral range of the beam over
    the length
    temperature_range_c: R(θ); expansion_um_per_m_c: α of the machine's scale; expansion_range_um_per_m_c: R(α)
    deviation_c: largest distance from 20 °C, None: that of the records; variation_um: E_VE
    """

    device_um: NotNegative = 0.0
    device_um_per_m: NotNegative = 0.0
    misalignment_mm: NotNegative = 0.0
    temperature_range_c: NotNegative = 0.0
    expansion_um_per_m_c: NotNegative = 11.7
    expansion_range_um_per_m_c: NotNegative = 0.0
    deviation_c: NotNegative | None = None
    variation_um: NotNegative = 0.0


@dataclass(frozen=True)
class Contribution:
    """One contribution. expanded_um: k = 2; how: its source in one sentence."""

    name: str
    how: str
    expanded_um: float


@dataclass(frozen=True)
class Budget:
    """lead: the first figure that the campaign has, A where it can be; contributions: to the lead, their squares add up to that of its
    U; figures_um: expanded (k = 2), by name, of the figures that the campaign has; targets_um: the part of each from the choice of
    targets.
    """

    length_mm: float
    lead: str
    contributions: tuple[Contribution, ...]
    figures_um: Mapping[str, float]
    targets_um: Mapping[str, float]


def budget(inputs: UncertaintyInputs, figures: Iso230, records: Records) -> Budget:
    """The uncertainty budget of one campaign (ISO/TR 230-9).

    Raises InputError where R(α) is given and neither the records nor the inputs give the distance from 20 °C, where nothing is stated
    but zeros, and for too few targets to show what their choice changes.
    """
    if figures.m < target_choice.FEWEST:
        fewest = target_choice.FEWEST
        raise InputError(
            f"{figures.m} targets do not show what another choice would change, expected at least {fewest}"
        )
    length_m = float(np.ptp(figures.target_mm)) / 1000.0
    stretch = _stretching(inputs, length_m, records)
    variation = Contribution(
        "environment", f"range of a drift test {inputs.variation_um:g} µm", RECTANGULAR * inputs.variation_um
    )
    if not any(one.expanded_um for one in (*stretch, variation)):
        raise InputError("[uncertainty] states nothing but zeros of instrument and room")
    stretched, n, m = sum(part.expanded_um**2 for part in stretch), figures.n, figures.m
    approaches = {"A": 4 + 2 / n, "E": 2 / n, "M": 1 / n, "R": 4 + 2 / n, "B": 2 / n, "B_mean": 2 / (n * m)}
    approaches |= {f"{name}_{one}": approaches[name] for name in ("A", "E") for one in ("up", "down")}
    approaches |= {"R_up": 4, "R_down": 4}
    targets = {name: target_choice.highest_um(curves) for name, curves in figures.curves().items()}
    if figures.B_i is not None:
        targets["B_mean"] = target_choice.mean_um(figures.B_i)
    known: dict[str, float] = {}
    for name, part in targets.items():
        along = stretched if name[0] in "AEM" else 0.0
        known[name] = math.sqrt(along + approaches[name] * variation.expanded_um**2 + part**2)
    lead = next(name for name in FIGURES if name in known)
    entering = replace(variation, expanded_um=math.sqrt(approaches[lead]) * variation.expanded_um)
    choice = Contribution("choice of targets", f"by the scatter between neighbours of {m} targets", targets[lead])
    return Budget(1000.0 * length_m, lead, (*stretch, entering, choice), known, targets)


def budget_um(inputs: UncertaintyInputs | None, figures: Iso230, records: Records) -> Mapping[str, float]:
    """Expanded uncertainty (k = 2) of each figure by name, µm; empty where the inputs, or the temperatures they need, are missing."""
    try:
        return {} if inputs is None else budget(inputs, figures, records).figures_um
    except InputError:
        return {}


def _stretching(inputs: UncertaintyInputs, length_m: float, records: Records) -> tuple[Contribution, ...]:
    deviation_c = farthest_from_reference_c(records) if inputs.deviation_c is None else inputs.deviation_c
    if deviation_c is None and inputs.expansion_range_um_per_m_c:
        raise InputError("the records hold no temperature, so how far from 20 °C it was has to be given (deviation_c)")
    play_mm, expansion = inputs.misalignment_mm, inputs.expansion_um_per_m_c
    return (
        Contribution(
            "device",
            f"certificate {inputs.device_um:g} µm + {inputs.device_um_per_m:g} µm/m",
            inputs.device_um + inputs.device_um_per_m * length_m,
        ),
        Contribution(
            "misalignment", f"beam within {play_mm:g} mm sideways", RECTANGULAR * play_mm**2 / (2.0 * length_m)
        ),
        Contribution(
            "temperature",
            f"measured within {inputs.temperature_range_c:g} °C, {expansion:g} µm/(m °C)",
            RECTANGULAR * expansion * length_m * inputs.temperature_range_c,
        ),
        Contribution(
            "expansion",
            f"coefficient within {inputs.expansion_range_um_per_m_c:g} µm/(m °C), {deviation_c or 0.0:.1f} °C from 20 °C",
            RECTANGULAR * (deviation_c or 0.0) * length_m * inputs.expansion_range_um_per_m_c,
        ),
    )


def farthest_from_reference_c(records: Records) -> float | None:
    """Largest distance from 20 °C in the `temp_*_c` columns, or in the air's where there are none; None without any
    temperature.
    """
    places = [name for name in records.columns if name.startswith("temp_") and name.endswith("_c")] or ["air_temp_c"]
    values = [records[name][np.isfinite(records[name])] for name in places if name in records]
    deviations = [float(np.max(np.abs(value - REFERENCE_C))) for value in values if len(value)]
    return max(deviations, default=None)


class Conformity(StrEnum):
    """What a measured value and its uncertainty prove against a limit."""

    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"


CONFORMITY_RULE = (
    "ISO 14253-1: pass where value + U ≤ limit, fail where value - U > limit, undecided between; U at k = 2"
)
"""The rule of `conformity`, as outputs state it. The guard band is U at k = 2 as in the editions of 1998 and 2013, wider than the
1.65 u which is enough for the 95 % that ISO 14253-1:2017 asks of one limit: a wrong pass has a probability of at most 2.3 %."""


def conformity(value: float, expanded: float | None, limit: float) -> Conformity:
    """Decision on a value that has an upper limit, by `CONFORMITY_RULE`. All three in one unit.

    expanded: U at k = 2; None where it is not known and 0 where nothing was stated of instrument and room: nothing is proven then.
    Raises InputError for numbers that are not finite and for a negative U.
    """
    if not (
        math.isfinite(value) and math.isfinite(limit) and math.isfinite(expanded or 0.0) and (expanded or 0.0) >= 0.0
    ):
        raise InputError(f"{value:g} with U = {expanded} against {limit:g}, expected finite numbers and U ≥ 0")
    if not expanded:
        return Conformity.UNDECIDED
    if value + expanded <= limit:
        return Conformity.PASS
    return Conformity.FAIL if value - expanded > limit else Conformity.UNDECIDED
