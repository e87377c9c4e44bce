"""What is taken away again from what the search took, and what is then left: one rule after the other, each says what it took and why.

An effect stays where it predicts runs left out, cannot do so by its kind (it occurs once), is beyond doubt on all rows, or leaves less
without a name. It goes all the same where it
- fits a few rows only,
- does little but undo another effect, or what was found without a name,
- is explained better by a function of other columns,
- or is not required beside what is left.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.diagnosis.campaign import CampaignRows
from hil.diagnosis.noise.evidence import Noise
from hil.diagnosis.policy import policy
from hil.diagnosis.remainder import LeftOver, left_over, sized
from hil.diagnosis.remainder.contest import beaten
from hil.diagnosis.search.choose import Chosen, beside_table, may_be_misfit, of_equal_rows, settle
from hil.diagnosis.search.select import drop
from hil.diagnosis.search.structure_estimate import StructureEstimate, structure_estimates
from hil.diagnosis.verdict.held_out import HeldOut, improves_held_out, on_few_rows
from hil.effects import Term

Floats = NDArray[np.float64]

UNNAMED = ""
"""Stands for what is left without a name, among the names of effects."""


@dataclass(frozen=True)
class Sifted:
    """A choice, the effects taken away from it by why, and what is left beside it.

    unproven: they do not improve runs left out; required: of these, those that were put back, because less is left with them
    few: they fit a few rows, and without those nothing of them is left; opposed: they do little but undo something else
    outdone: a function of other columns explains better what they do; unneeded: not required beside what is left
    left: what is left that no effect of the fit may have, largest first
    misfits: what is left in the columns of an effect that was found, whose form is not quite the machine's
    structures: smooth functions that the search fitted on the way
    unexplained: something has no cause, whether its columns are known (left) or not
    """

    chosen: Chosen
    unproven: tuple[str, ...] = ()
    required: frozenset[str] = frozenset()
    few: frozenset[str] = frozenset()
    opposed: frozenset[str] = frozenset()
    outdone: frozenset[str] = frozenset()
    unneeded: frozenset[str] = frozenset()
    left: tuple[LeftOver, ...] = ()
    misfits: tuple[LeftOver, ...] = ()
    structures: tuple[StructureEstimate, ...] = ()
    unexplained: bool = False

    @property
    def effects(self) -> set[str]:
        """Ids of the effects of the fit."""
        return {choice.effect.id for choice in self.chosen.kept}

    @property
    def missing(self) -> tuple[str, ...]:
        """The unproven effects that did not come back, or not to stay."""
        return tuple(name for name in self.unproven if name not in self.required & self.effects)

    @property
    def notes(self) -> Iterator[str]:
        """What was taken away, a line for each effect but the `missing` ones."""
        for names, why in (
            (self.few, "fits a few of these rows, and without them nothing of it is left"),
            (self.opposed, "does little but undo something else that was fitted to these rows"),
            (self.outdone, "is explained better by a function of other columns"),
            (self.unneeded, "is not required beside what is left unexplained"),
        ):
            yield from (f"{name} {why}: not taken" for name in sorted(names - set(self.missing)))

    @property
    def misfit_notes(self) -> Iterator[str]:
        """What is left of effects that were found."""
        for left in self.misfits:
            yield (
                f"{left.rms} µm RMS along {' × '.join(left.columns)} are left of an effect that was found: its form is not"
                " quite this"
            )


def sift(chosen: Chosen, left_out: HeldOut, *, is_saturated: bool) -> Sifted:
    """The choice without what the records do not require, and what is left beside it.

    is_saturated: the table leaves no rows to tell anything else by, so nothing is left
    """
    proven = without_resembling(without_unproven(chosen, left_out))
    beside = proven if is_saturated else with_those_required(_with_rest(proven))
    last = beside.chosen.last
    structures = structure_estimates(last.searcher, beside.chosen.hits, beside.chosen.kept, last.noise)
    misfits, nobodys = _parted(beside.left, lambda one: _is_misfit(one, beside.chosen))
    whole = beside_the_rest(replace(beside, left=nobodys, misfits=misfits, structures=structures), nobodys)
    return replace(whole, unexplained=whole.unexplained or bool(whole.left))


def _parted(
    left: Sequence[LeftOver], is_first: Callable[[LeftOver], bool]
) -> tuple[tuple[LeftOver, ...], tuple[LeftOver, ...]]:
    first = [is_first(one) for one in left]
    return tuple(itertools.compress(left, first)), tuple(itertools.compress(left, [not one for one in first]))


def without_unproven(chosen: Chosen, left_out: HeldOut) -> Sifted:
    """Without the terms that do not improve runs left out. Unexplained where a structure that the search found is beyond doubt, or
    improves them, or where the noise has a long memory.
    """
    last = chosen.last
    sure = {effect for selected in chosen.selections for effect in selected.beyond(policy().accepted_from)}
    kept = tuple(
        c for c in last.choices if c.effect.once or c.effect.id in sure or improves_held_out(left_out.gain[c.effect.id])
    )
    hits = chosen.hits
    unexplained = bool(hits) and (
        max(hit.gain for hit in hits) > policy().accepted_from or improves_held_out(left_out.structure)
    )
    unexplained = unexplained or last.memory is not None
    if len(kept) == len(last.choices):
        return Sifted(chosen, unexplained=unexplained)
    unproven = tuple(dict.fromkeys(c.effect.id for c in last.choices if c not in kept))
    return Sifted(replace(chosen, fit=last.searcher.fit(kept, last.noise)), unproven, unexplained=unexplained)


def without_resembling(before: Sifted) -> Sifted:
    """Without the effects that only resemble what the rows hold: those that undo something, those of a few rows far off, and those
    that a function of other columns beats.
    """
    apart = without_opposed(before)
    chosen, few = apart.chosen, on_few_rows(apart.chosen)
    chosen = refitted_without(chosen, few, chosen.last.noise) if few else chosen
    lost = beaten(chosen.last.searcher, chosen.kept, chosen.last.noise)
    chosen = refitted_without(chosen, lost, chosen.last.noise) if lost else chosen
    return replace(apart, chosen=chosen, few=frozenset(few), outdone=frozenset(lost))


def without_opposed(before: Sifted) -> Sifted:
    """Without the effects that only undo another one, or what was found without a name; unexplained where one was far larger than all
    errors, as what it was to explain has no cause then.

    Two courses beside the table, both larger than the noise, are each other's opposite but for a small part, or two as they are, both
    larger than all errors: their difference is then as large as one likes, and no other campaign has it. Of two effects the one that
    the rows require less goes. (520 and -520 µm were fitted to errors of 1 µm.) So does one that is larger than all errors by far
    (the policy's `most_times`): others, or the table, undo it.
    """
    chosen, opposed, beyond = before.chosen, set(before.opposed), before.unexplained
    last = chosen.last
    columns, errors_um = last.searcher.linear.campaign.columns, float(np.std(last.searcher.linear.campaign.error_um))
    while True:
        courses = {UNNAMED: chosen.fit.nuisance_um}
        for term in chosen.fit.found:
            courses[term.effect.id] = courses.get(term.effect.id, 0.0) + term.error_um(columns)
        beside = {name: beside_table(chosen, course_um) for name, course_um in courses.items()}
        left: dict[tuple[str, ...], float] = {}
        for some, noise_um in ((beside, chosen.fit.white_um), (courses, policy().whole_opposed_from * errors_um)):
            size_um = {name: float(np.std(course_um)) for name, course_um in some.items()}
            for one, other in itertools.combinations([name for name in some if size_um[name] > noise_um], 2):
                share = float(np.std(some[one] + some[other])) / min(size_um[one], size_um[other])
                left[one, other] = min(share, left.get((one, other), share))
        pair: tuple[str, ...] = min(left, key=left.__getitem__, default=())
        if not pair or left[pair] >= policy().opposed:
            whole_um = {name: float(np.std(course_um)) for name, course_um in courses.items() if name != UNNAMED}
            largest = max(whole_um, key=whole_um.__getitem__, default=UNNAMED)
            if whole_um.get(largest, 0.0) <= policy().most_times * errors_um:
                return replace(before, chosen=chosen, opposed=frozenset(opposed), unexplained=beyond)
            pair, beyond = (largest,), True
        without = {name: refitted_without(chosen, {name}, last.noise) for name in pair if name != UNNAMED}
        less = max(without, key=lambda name: last.searcher.evidence(without[name].kept, last.noise))
        opposed.add(less)
        chosen = without[less]


def _with_rest(before: Sifted) -> Sifted:
    """The same with what is left beside the effects of its fit."""
    last = before.chosen.last
    return replace(before, left=left_over(last.searcher, before.chosen.kept, last.noise, before.chosen.unclaimed))


def with_those_required(before: Sifted) -> Sifted:
    """With the unproven effects put back with which less is left, and without others that only undo one of these.

    None comes back that a function of other columns explains better, or that only undoes another. Run offsets, and few runs, hide from
    runs left out what all rows together show.
    """
    chosen, last = before.chosen, before.chosen.last
    if not before.left or not before.unproven:
        return before
    back = set(before.unproven) - beaten(last.searcher, last.choices, last.noise)
    if not back:
        return before
    kept = before.effects | back
    again = [choice for choice in last.choices if choice.effect.id in kept]
    both = without_opposed(replace(before, chosen=replace(chosen, fit=last.searcher.fit(again, last.noise))))
    back -= both.opposed
    if not back:
        return before
    beside = _with_rest(both)
    if sum(one.rms.value for one in beside.left) >= sum(one.rms.value for one in before.left):
        return before
    opposed = before.opposed | (both.opposed - set(before.unproven))
    return replace(beside, required=frozenset(back), opposed=opposed)


def beside_the_rest(before: Sifted, new: Sequence[LeftOver]) -> Sifted:
    """The fit again beside what is left, without the terms that the records do not require beside that. Where a term went, what is
    left is sized again, as the term may have undone a part of it.

    new: what of it is not in the fit so far; the same is returned where that is nothing
    """
    chosen = before.chosen
    new = [one for one in new if not _is_wander(one, chosen)]
    if not new:
        return before
    last = chosen.last
    for one in new:
        last.searcher.add_nuisance(one.extra)
    last.searcher.limit_outliers(chosen.kept, last.noise)
    kept = drop(last.searcher, chosen.kept, last.noise)
    noise = last.searcher.fit_noise(kept, last.noise)
    last.searcher.limit_outliers(kept, noise)
    selections = (*chosen.selections[:-1], replace(last, choices=tuple(kept), noise=noise))
    fit = last.searcher.fit(kept, noise)
    again = without_opposed(replace(before, chosen=settle(replace(chosen, selections=selections, fit=fit))))
    wander, beside = _parted(before.left, lambda one: _is_wander(one, chosen))
    if len(again.chosen.kept) == len(chosen.kept) and len(beside) == len(new):
        return again
    sizes = (*sized(last.searcher, again.chosen.kept, noise, beside), *wander)
    gone = before.effects - again.effects - again.opposed - set(before.unproven)
    return replace(again, left=tuple(sorted(sizes, key=lambda one: -one.rms.value)), unneeded=before.unneeded | gone)


def _is_wander(left: LeftOver, chosen: Chosen) -> bool:
    """Whether what is left follows time alone beside a reading that wanders: any course of time is that."""
    return wanders(chosen) and left.columns == (_campaign(chosen).survey.time_column,)


def wanders(chosen: Chosen) -> bool:
    """Whether an effect is a random course, which no other run can predict."""
    return any(choice.form.shrunk for choice in chosen.kept)


def _campaign(chosen: Chosen) -> CampaignRows:
    return chosen.last.searcher.linear.campaign


def _is_misfit(left: LeftOver, chosen: Chosen) -> bool:
    """Whether what is left is an effect's own: small, of its columns, so that its form is not quite the machine's; or a course of time
    that moves with no other column, beside a reading that wanders.
    """
    if _is_wander(left, chosen) and not left.equivalent:
        return True
    columns, projection = _campaign(chosen).columns, of_equal_rows(chosen)
    return any(
        _is_in_columns(left, term, chosen)
        and left.rms.value < policy().shape * projection.rms_left(term.error_um(columns))
        for term in chosen.fit.found
    )


def _is_in_columns(left: LeftOver, term: Term, chosen: Chosen) -> bool:
    return may_be_misfit(left.columns, term.form, _campaign(chosen).survey)


def refitted_without(chosen: Chosen, effects: Collection[str], noise: Noise) -> Chosen:
    """The fit again without some effects."""
    kept = [choice for choice in chosen.kept if choice.effect.id not in effects]
    return replace(chosen, fit=chosen.last.searcher.fit(kept, noise))
