"""The estimate of one rise, with uncertainties, from measured reversals: shapes compared over the load's own travel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from drivers.errors import InputError
from hil.correction.rise import RUNNABLE, TWO_TANH, Rise, RiseShape
from hil.lost_motion.fit import Contender, MeasuredReversal, as_stated, compete, uncertainties

STILL_RISING_SHARE = 0.03
"""Share of the lost motion that may come back over the second half of the travel measured."""
DETERMINED_FROM_STD = 2.0
"""Own standard uncertainties from which a single amount or length of a sum counts as determined."""
LEAST_SHARE = 1e-3
"""Share of the whole below which a single amount counts as 0."""
NOT_SEPARATELY_DETERMINED = "not determined one by one, only their sum"
"""Phrase for single amounts of a sum."""


@dataclass(frozen=True)
class Uncertain:
    """A value with its standard uncertainty, unit as the parameter's name says; as text with the expanded one (k = 2)."""

    value: float
    std: float

    def __str__(self) -> str:
        return f"{self.value:.4g} ± {2.0 * self.std:.2g}" if self.std else f"{self.value:.4g}"


@dataclass(frozen=True)
class ReversalFit:
    """The result of the fit to some reversals.

    rise: over the load's travel; parameters: of it, and published: of the two tanh terms, by name with standard
    uncertainties
    contenders: the best on held-out strokes first; reversals: as measured, over the motor's travel
    late_um: part of the lost motion that came back over the second half of the travel measured
    asked_for: the shape was asked for, and not chosen; typed: its parameters too
    """

    rise: Rise
    parameters: dict[str, Uncertain]
    published: dict[str, Uncertain]
    contenders: tuple[Contender, ...]
    reversals: tuple[MeasuredReversal, ...]
    late_um: float
    asked_for: bool = False
    typed: bool = False

    @property
    def choice(self) -> str:
        """Which shape is taken, and by how much it is better or worse on held-out strokes than two tanh or the best of the others."""
        taken, *rest = sorted(self.contenders, key=lambda one: one.fitted.rise is not self.rise)
        two_tanh = next((one for one in rest if one.fitted.shape is TWO_TANH), None)
        if self.typed and two_tanh is not None:
            return f"two tanh typed: {taken.rms_um:.3f} µm RMS on the strokes, two tanh fitted {two_tanh.rms_um:.3f}"
        other = two_tanh or min(rest, key=lambda one: one.held_out_rms_um)
        if two_tanh is not None and self.asked_for:
            other = min(rest, key=lambda one: one.held_out_rms_um)
        taken_um, other_um = taken.held_out_rms_um, other.held_out_rms_um
        share = "" if taken_um == 0.0 else f" ({100.0 * (other_um / taken_um - 1.0):+.0f} %)"
        return (
            f"{taken.fitted.shape.name} {'asked for' if self.asked_for else 'taken'}: {taken_um:.3f} µm RMS on strokes held out,"
            f" {other.fitted.shape.name} {other_um:.3f}{share}"
        )

    @property
    def amount_um(self) -> float:
        """The whole lost motion, µm."""
        return self.rise.amount_um

    @property
    def determined(self) -> dict[str, Uncertain]:
        """The parameters that the data determine, see `determined` below."""
        return determined(self.parameters)

    @property
    def still_rising(self) -> bool:
        """Whether the strokes were too short for the whole lost motion."""
        return self.late_um > STILL_RISING_SHARE * self.amount_um

    def to_json(self) -> dict[str, Any]:
        """Plain values for a result file."""
        return {
            "rise": self.rise.to_json(),
            "amount_um": self.amount_um,
            "parameters": _plain(self.parameters),
            "determined": sorted(self.determined),
            "published": _plain(self.published),
            "late_um": self.late_um,
            "asked_for": self.asked_for,
            "typed": self.typed,
            "choice": self.choice if self.contenders else "",
            "contenders": [
                {"rise": one.fitted.rise.to_json(), "rms_um": one.rms_um, "held_out_rms_um": one.held_out_rms_um}
                for one in self.contenders
            ],
        }


def estimate(
    reversals: Sequence[MeasuredReversal],
    shortest_mm: float,
    asked: RiseShape | Rise | None = None,
    noise_um: float = 0.0,
) -> ReversalFit:
    """The rise of these reversals, from which the errors of position have been removed.

    shortest_mm: shortest rise length; asked: the shape asked for, or a rise with its parameters, over the load's travel; None for two
    tanh terms, unless another shape's RMS on strokes held out is smaller by more than noise_um, the standard deviation of a reading.
    Raises InputError with fewer than 3 reversals, of which one is held out.
    """
    if len(reversals) < 3:
        raise InputError(f"{len(reversals)} reversals, expected at least 3")
    by_load = [reversal.by_load() for reversal in reversals]
    contenders = compete(by_load, shortest_mm, RUNNABLE, table=False)
    two_tanh = next(one for one in contenders if one.fitted.shape is TWO_TANH)
    published = uncertain(two_tanh.fitted.rise, by_load, shortest_mm)
    late_um = _late_um(contenders[0].fitted.rise, by_load)
    if isinstance(asked, Rise):
        contenders = (as_stated(asked, by_load), *contenders)
        parameters = {name: Uncertain(value, 0.0) for name, value in _values(asked).items()}
        return ReversalFit(
            asked, parameters, published, contenders, tuple(reversals), late_um, asked_for=True, typed=True
        )
    best = contenders[0]
    if asked is not None:
        best = next(one for one in contenders if one.fitted.shape is asked)
    elif best.held_out_rms_um + noise_um >= two_tanh.held_out_rms_um:
        best = two_tanh
    rise = best.fitted.rise
    parameters = published if best is two_tanh else uncertain(rise, by_load, shortest_mm)
    return ReversalFit(rise, parameters, published, contenders, tuple(reversals), late_um, asked is not None)


def with_two_tanh(found: ReversalFit) -> ReversalFit:
    """The same measurement with the two tanh terms fitted to it in place of the shape taken."""
    rise = next(one.fitted.rise for one in found.contenders if one.fitted.shape is TWO_TANH)
    return replace(found, rise=rise, parameters=found.published)


def _late_um(rise: Rise, by_load: Sequence[MeasuredReversal]) -> float:
    """What comes back over the second half of the travel by the shape that describes the strokes best, whichever is put into force."""
    end_mm = max(float(reversal.travel_mm.max()) for reversal in by_load)
    return rise.risen_um(end_mm) - rise.risen_um(end_mm / 2.0)


def _plain(parameters: Mapping[str, Uncertain]) -> dict[str, dict[str, float]]:
    return {name: {"value": each.value, "std": each.std} for name, each in parameters.items()}


def uncertain(rise: Rise, reversals: Sequence[MeasuredReversal], shortest_mm: float) -> dict[str, Uncertain]:
    """Parameters by their usual names (µm, mm), each with its standard uncertainty; of a piecewise linear rise the
    whole amount only.

    rise: as fitted to these reversals, over the load's travel; shortest_mm: shortest rise length of that fit
    """
    u_whole, u_amounts, u_lengths = uncertainties(rise, reversals, shortest_mm)
    stds = [u_whole, *(u_amounts if len(u_amounts) > 1 else []), *u_lengths]
    return {name: Uncertain(value, std) for (name, value), std in zip(_values(rise).items(), stds, strict=False)}


def _values(rise: Rise) -> dict[str, float]:
    """The parameters by their usual names; of a piecewise linear rise the whole amount only."""
    shape, amounts, lengths = rise.shape, rise.amounts_um, rise.lengths_mm
    found = {"amount_um": rise.amount_um}
    if shape.knots:
        return found
    if len(amounts) > 1:
        found |= {f"amount_{k + 1}_um": amount for k, amount in enumerate(amounts)}
    found |= {f"rise_{k + 1}_mm": lengths[k] for k in range(shape.rises)}
    return found | ({"onset_2_mm": lengths[-1]} if shape.onsets else {})


def separately_determined(parameters: Mapping[str, Uncertain]) -> bool:
    """Whether the amounts of a sum of terms are determined one by one; True for a shape of one term.

    Where one term would fit as well, two can share its amount in any proportion: each is undetermined, though their sum
    is well known.
    """
    whole_um = parameters["amount_um"].value
    singles = [each for name, each in parameters.items() if _is_single(name)]
    return all(one.value > max(DETERMINED_FROM_STD * one.std, LEAST_SHARE * whole_um) for one in singles)


def determined(parameters: Mapping[str, Uncertain]) -> dict[str, Uncertain]:
    """All parameters; where single amounts are not determined, the whole amount instead, and the lengths that are."""
    if separately_determined(parameters):
        return dict(parameters)
    kept = (name for name in parameters if name != "amount_um" and not _is_single(name))
    sure = {name: each for name in kept if (each := parameters[name]).value > DETERMINED_FROM_STD * each.std > 0.0}
    return {"amount_um": parameters["amount_um"], **sure}


def _is_single(name: str) -> bool:
    return name.startswith("amount_") and name != "amount_um"
