"""Figures of the study from its outcomes: shares with Wilson's 95 % interval, fresh errors, calibration of the
confidences.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import binomtest
from study.grammar.judge import CONFIDENT, FALSE_RATE, Outcome, detected

BINS = (0.0, 0.5, 0.7, 0.9, 0.97, 1.0)
"""Edges of the reliability table."""
DRAWS = 4000
"""Draws of the machines, with repetition, behind the interval of a ratio of two shares."""
GENERAL = ("vary apart", "a second campaign under other conditions")
"""In every advice that names no run but only says of columns that they must."""


NOT_TOLD = "do not tell which it follows"
"""In the explanation of a finding that may follow several columns."""


def share(hits: Sequence[bool]) -> dict[str, Any]:
    """Count, number, share and its Wilson interval at 95 %."""
    n, k = len(hits), int(sum(hits))
    if not n:
        return {"of": 0, "count": 0}
    interval = binomtest(k, n).proportion_ci(0.95, "wilson")
    return {"of": n, "count": k, "share": k / n, "wilson_95": [float(interval.low), float(interval.high)]}


def text(one: Any) -> str:
    """A figure of `figures` on one line."""
    if isinstance(one, dict) and "wilson_95" in one:
        low, high = (100 * edge for edge in one["wilson_95"])
        return f"{one['count']} of {one['of']} = {100 * one['share']:.1f} % ({low:.1f} to {high:.1f})"
    if isinstance(one, dict) and "of" in one:
        return "none drawn"
    if isinstance(one, dict):
        return ", ".join(f"{name} {text(value)}" for name, value in one.items())
    return f"{one:.3f}" if isinstance(one, float) else str(one)


def quantiles(values: Sequence[float]) -> dict[str, float]:
    """Median and 90 %."""
    if not len(values):
        return {}
    return {
        "median": float(np.quantile(values, 0.5)),
        "90 %": float(np.quantile(values, 0.9)),
        "worst": float(np.max(values)),
    }


def ratio(hits: Sequence[bool], of: Sequence[bool]) -> dict[str, Any]:
    """Share of `hits` over that of `of`, of the same machines, with a percentile interval at 95 % over draws of the machines."""
    above, below = np.array(hits, dtype=float), np.array(of, dtype=float)
    if not below.sum():
        return {}
    draws = np.random.default_rng(1).integers(0, len(above), (DRAWS, len(above)))
    drawn = above[draws].sum(axis=1) / np.maximum(below[draws].sum(axis=1), 1.0)
    low, high = np.quantile(drawn, [0.025, 0.975])
    return {"ratio": float(above.sum() / below.sum()), "low": float(low), "high": float(high)}


def likeliest(one: Outcome) -> bool:
    """Whether the first finding is stated with no less confidence than each of its rivals."""
    findings = one["said"]["findings"]
    return bool(findings) and all(findings[0]["confidence"] >= rival[1] for rival in findings[0]["rivals"])


def figures(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """The figures of one lot, all outcomes of which have the same `lot`."""
    lot = outcomes[0]["lot"]
    good = [one for one in outcomes if "error" not in one]
    found: dict[str, Any] = {"machines": len(outcomes), "refused by a verb": len(outcomes) - len(good)}
    if not good:
        return found
    free, held = [one for one in good if not one["held"]], [one for one in good if one["held"]]
    found |= _LOTS[lot](free)
    if held:
        found["held by the table: named first or silent"] = share([one["named_first"] or one["silent"] for one in held])
    found[f"a wrong name above {CONFIDENT}"] = share([bool(one["confident_wrong"]) for one in good])
    found["unexplained"] = share([one["said"]["unexplained"] for one in good])
    found["fresh RMS / that of the table of `hil fit` alone"] = quantiles(
        [one["fresh_um"] / one["table_um"] for one in free]
    )
    if not lot.startswith("outside") and lot != "missing":
        found["fresh RMS / true model's"] = quantiles([one["fresh_um"] / one["fresh_true_um"] for one in free])
        told = [one for one in free if is_told(one)]
        found["machines of which it says cause and column surely"] = share([is_told(one) for one in free])
        found["fresh RMS / true model's, of those"] = quantiles(
            [one["fresh_um"] / one["fresh_true_um"] for one in told]
        )
        found["true forms with fitted amplitudes, the same"] = quantiles(
            [one["fresh_fitted_um"] / one["fresh_true_um"] for one in free]
        )
        found["true forms with lags, points, periods … fitted, the same"] = quantiles(
            [one["fresh_all_fitted_um"] / one["fresh_true_um"] for one in free if "fresh_all_fitted_um" in one]
        )
        found["table alone, the same"] = quantiles([one["table_um"] / one["fresh_true_um"] for one in free])
    found["seconds"] = quantiles([one["said"]["seconds"] for one in good])
    return found


def is_told(one: Outcome) -> bool:
    """Whether the program is sure of the first name, and of the column that it follows: rows in which two columns moved together tell
    neither, and a campaign in which they part is then another machine's.
    """
    first = next(iter(one["said"]["findings"]), None)
    return first is not None and first["confidence"] > CONFIDENT and NOT_TOLD not in first["explanation"]


def _known(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    seen = [detected(one) for one in outcomes]
    first = [one["named_first"] for one in outcomes]
    found = {
        "named first": share(first),
        "named first, and with no less confidence than any rival": share(
            [one["named_first"] and likeliest(one) for one in outcomes]
        ),
        f"detected by who knows form and noise ({FALSE_RATE:.0%} false)": share(seen),
        "named first over detected": ratio(first, seen),
        "of these, named first": share([a for a, b in zip(first, seen, strict=True) if b]),
        "another cause looks the same on these rows: named first": share(
            [one["named_first"] for one in outcomes if one["twin"]]
        ),
        "no other cause looks the same: named first": share(
            [one["named_first"] for one in outcomes if not one["twin"]]
        ),
        "silent": share([one["silent"] for one in outcomes]),
        "beside an older table, named first": share(
            [one["named_first"] for one in outcomes if one["truth"]["older_table"]]
        ),
    }
    return found | _by(
        "named first", outcomes, lambda one: one["truth"]["causes"][0]["name"], lambda one: one["named_first"]
    )


def _pairs(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    return {
        "both named": share([one["all_named"] for one in outcomes]),
        "no other cause looks like either: both named": share(
            [one["all_named"] for one in outcomes if not one["twin"]]
        ),
        "at least one": share(
            [bool(one["named_first"] or one["all_named"] or any(r for _, r in one["confidences"])) for one in outcomes]
        ),
        "both detected by who knows form and noise": share([detected(one) for one in outcomes]),
    }


def _outside(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    found_it = [one["said"]["unexplained"] or one["named_first"] for one in outcomes]
    seen = [one["reference_p"][0] < FALSE_RATE for one in outcomes]
    told = [one for one in outcomes if one["size_ratio"] is not None]
    sizes = [abs(one["size_ratio"] - 1.0) for one in told]
    found = {
        "unexplained, or a pure course of time named so": share(found_it),
        "detected by who knows form and noise": share(seen),
        "columns named in any part, of the unexplained": share([one["carriers_named"] for one in told]),
        "columns named in any part, of all machines": share([bool(one["carriers_named"]) for one in outcomes]),
        "columns named in the first part": share([one["carriers_first"] for one in told]),
        "size off by (part of the truth)": quantiles(sizes),
        "size within 25 %": share([size <= 0.25 for size in sizes]),
    }
    return found | _by(
        "unexplained",
        outcomes,
        lambda one: one["truth"]["causes"][0]["family"],
        lambda one: one["said"]["unexplained"] or one["named_first"],
    )


def _clean(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    found = {
        "with a finding": share([bool(one["said"]["findings"]) for one in outcomes]),
        "with anything said": share([not one["silent"] for one in outcomes]),
        "with anything said or suspected": share(
            [not one["silent"] or any("is suspected" in note for note in one["said"]["notes"]) for one in outcomes]
        ),
        "with a note of any kind": share([bool(one["said"]["notes"]) for one in outcomes]),
    }
    for what, hit in (
        ("with a finding", lambda one: one["said"]["findings"]),
        ("anything said", lambda one: not one["silent"]),
    ):
        found |= _by(what, outcomes, lambda one: one["truth"]["noise"], hit)
    return found


def _missing(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    found = {
        "true name first": share([one["named_first"] for one in outcomes]),
        "true name among a set of rivals": share([one["in_a_set"] for one in outcomes]),
        "true name in a set, unexplained or silent": share(
            [one["in_a_set"] or one["said"]["unexplained"] or one["silent"] for one in outcomes]
        ),
        "silent": share([one["silent"] for one in outcomes]),
    }
    bare = [one for one in outcomes if not one["truth"]["logged"]]
    without = [one for one in outcomes if any(name.startswith("temp_") for name in one["truth"]["removed"])]
    for what, own in (("only what is required was logged", bare), ("its temperature was not logged", without)):
        found[f"{what}: true name in a set"] = share([one["in_a_set"] for one in own])
        found[f"{what}: a wrong name above {CONFIDENT}"] = share([bool(one["confident_wrong"]) for one in own])
    sets = [finding["rivals"] for one in outcomes for finding in one["said"]["findings"]]
    found["names in a set, with the one found"] = quantiles([1 + len(rivals) for rivals in sets])
    said = [[rival[2] for rival in rivals if len(rival) > 2 and rival[2]] for rivals in sets if rivals]
    found["sets in which a run is named that separates two names"] = share(
        [any(not any(general in one for general in GENERAL) for one in own) for own in said]
    )
    return found | _by("in a set", outcomes, lambda one: one["truth"]["causes"][0]["name"], lambda one: one["in_a_set"])


_LOTS: dict[str, Callable[[Sequence[Outcome]], dict[str, Any]]] = {
    "strong": _known,
    "weak": _known,
    "outside strong": _outside,
    "outside weak": _outside,
    "clean": _clean,
    "pairs": _pairs,
    "missing": _missing,
}


def _by(
    what: str, outcomes: Sequence[Outcome], key: Callable[[Outcome], str], hit: Callable[[Outcome], bool]
) -> dict[str, Any]:
    groups: dict[str, list[bool]] = defaultdict(list)
    for one in outcomes:
        groups[key(one)].append(bool(hit(one)))
    return {f"{what}, {name}": share(hits) for name, hits in sorted(groups.items())}


def right(one: Outcome) -> bool:
    """Whether one machine's verdict is what its lot asks for; decides what is listed as a miss."""
    if "error" in one or one["confident_wrong"]:
        return False
    lot = one["lot"]
    if lot == "clean":
        return bool(one["silent"])
    if lot.startswith("outside"):
        return bool(one["said"]["unexplained"] or one["named_first"])
    if lot == "pairs":
        return bool(one["all_named"])
    if lot == "missing":
        return bool(one["in_a_set"] or one["said"]["unexplained"] or one["silent"])
    return bool(one["named_first"] or (one["held"] and one["silent"]))


def picture(outcomes: Sequence[Outcome], path: Path) -> None:
    """The reliability diagram: of the names said with a confidence, the share that is right, with its interval."""
    bins = [value for name, value in calibration(outcomes).items() if name.startswith("said") and name != _SURE]
    said, right_of = [one["mean confidence"] for one in bins], [one["right"] for one in bins]
    shares = np.array([one["share"] for one in right_of])
    edges = np.abs(np.array([one["wilson_95"] for one in right_of]).T - shares)
    figure = Figure(figsize=(5.0, 4.2), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    axes.errorbar(said, shares, edges, fmt="o", capsize=3)
    for x, y, one in zip(said, shares, right_of, strict=True):
        axes.annotate(f"{one['of']}", (x, y), (-5, 5), textcoords="offset points", ha="right", fontsize=8)
    axes.set(xlabel="confidence said, mean of a bin", ylabel="share of right names", xlim=(0, 1.03), ylim=(0, 1.03))
    figure.savefig(path, dpi=110)


_SURE = f"said {CONFIDENT:g} to 1"


def calibration(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Share of right names per bin of confidence, and the Brier score of all findings."""
    good = [one for one in outcomes if "error" not in one]
    pairs = [(float(c), bool(r)) for one in good for c, r in one["confidences"]]
    found: dict[str, Any] = {"machines": len(good), "findings": len(pairs)}
    for low, high in (*pairwise(BINS), (CONFIDENT, 1.0)):
        inside = [(c, r) for c, r in pairs if low < c <= high or (low == 0.0 and c == 0.0)]
        if inside:
            found[f"said {low:g} to {high:g}"] = {
                "mean confidence": float(np.mean([c for c, _ in inside])),
                "right": share([r for _, r in inside]),
            }
    found["true parameter within its interval at 95 %"] = share(
        [held for one in good for held in one["parameters"].values()]
    )
    if pairs:
        found["Brier score"] = float(np.mean([(c - r) ** 2 for c, r in pairs]))
    return found
