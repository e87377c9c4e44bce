"""The frozen judge of two engines: outcomes of machines, one JSON line each, written as they come with the lots in turn,
and two such files side by side on the machines that both have.

`python tests/study/grammar/frozen.py run OUT.jsonl --seeds reporting --first 10900 --machines 50` goes on where OUT ends;
`python tests/study/grammar/frozen.py compare OLD.jsonl NEW.jsonl`;
`python tests/study/grammar/frozen.py page` writes `hil/docs/diagnosis_lots.md`.

`outcomes/` has those of the engine before (search.jsonl) and of the model; seconds are of a busy computer.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

if not __package__:  # run as a file: its own place would hide the package
    sys.path[0] = str(Path(__file__).resolve().parents[2])

import numpy as np
from study.grammar.judge import Outcome, outcome
from study.grammar.machine import LOTS, SEEDS
from study.grammar.report import quantiles, right, share, text
from study.next_study import Outcome as Asked
from study.next_study import of_json
from study.next_study import summary as of_runs_asked

KEPT = (
    "lot", "seed", "error", "held", "twin", "named_first", "all_named", "in_a_set", "silent", "confident_wrong", "confidences",
    "parameters", "carriers_named", "size_ratio", "fresh_um", "table_um", "fresh_true_um", "reference_p",
)  # fmt: skip
"""Fields of an outcome that a comparison reads."""


def compact(one: Outcome) -> dict[str, Any]:
    """An outcome in one short line."""
    kept = {name: one[name] for name in KEPT if name in one}
    causes = one["truth"]["causes"]
    kept["truth"] = [[c["name"], c["family"], round(c["ratio"], 2), c["columns"]] for c in causes]
    said = one.get("said")
    if said:
        kept["said"] = {
            "findings": [[f["effect"], f["confidence"], [r[:2] for r in f["rivals"]]] for f in said["findings"]],
            "unexplained": said["unexplained"],
            "carried_by": [c["columns"] for c in said["carried_by"]],
            "suspected": any("is suspected" in note for note in said["notes"]),
            "seconds": said["seconds"],
        }
    return dict(json.loads(json.dumps(kept), parse_float=lambda number: float(f"{float(number):.4g}")))


def run(path: Path, lots: Sequence[str], numbers: Sequence[int]) -> None:
    """Appends the outcomes that the file does not have yet: the first seed of each lot, then the second …"""
    done = {(one["lot"], one["seed"]) for one in read(path)} if path.exists() else set()
    for seed in numbers:
        for lot in lots:
            if (lot, seed) in done:
                continue
            line = compact(outcome(lot, seed))
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")


def read(path: Path) -> list[Outcome]:
    """The outcomes of a file."""
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]


def asked(one: Outcome) -> bool:
    """What the lot asks for; confident wrong names are counted apart."""
    return bool(right(one | {"confident_wrong": []}))


FIGURES: dict[str, Callable[[Outcome], bool]] = {
    "right": asked,
    "wrong above 0.9": lambda one: bool(one["confident_wrong"]),
    "unexplained": lambda one: bool(one["said"]["unexplained"]),
    "silent": lambda one: bool(one["silent"]),
}


def compare(files: Sequence[Path]) -> None:
    """Prints figures of each lot, a line for each file, on the machines that all files have."""
    by_file = [{(one["lot"], one["seed"]): one for one in read(path)} for path in files]
    both = sorted(set.intersection(*(set(one) for one in by_file)))
    for lot in LOTS:
        keys = [key for key in both if key[0] == lot]
        good = [key for key in keys if all("error" not in one[key] for one in by_file)]
        print(f"\n{lot}: {len(keys)} machines, refused by one {len(keys) - len(good)}")
        for path, outcomes in zip(files, by_file, strict=True):
            own = [outcomes[key] for key in good]
            if not own:
                continue
            words = [f"{name} {text(share([hit(one) for one in own]))}" for name, hit in FIGURES.items()]
            fresh = quantiles([one["fresh_um"] / one["fresh_true_um"] for one in own if not one["held"]])
            words += [f"fresh {text(fresh)}", f"seconds {text(quantiles([one['said']['seconds'] for one in own]))}"]
            print(f"  {path.stem}: " + "; ".join(words))
        if len(files) == 2:
            _differences([(by_file[0][key], by_file[1][key]) for key in good])


def _differences(pairs: Sequence[tuple[Outcome, Outcome]]) -> None:
    for name, hit in FIGURES.items():
        won = [new["seed"] for old, new in pairs if hit(new) and not hit(old)]
        lost = [new["seed"] for old, new in pairs if hit(old) and not hit(new)]
        if won or lost:
            change = np.array([float(hit(new)) - float(hit(old)) for old, new in pairs])
            half = 1.96 * float(np.std(change)) / max(len(change), 1) ** 0.5
            print(f"    {name}: {np.mean(change):+.3f} ± {half:.3f}, only new {won}, only old {lost}")


OUTCOMES = Path(__file__).parent / "outcomes"
PAGE = Path(__file__).parents[3] / "hil/docs/diagnosis_lots.md"
KINDS: dict[str, tuple[tuple[str, ...], str]] = {
    "one strong cause of the catalogue": (("strong",), "named first"),
    "one weak cause of the catalogue": (("weak",), "named first"),
    "two strong causes": (("pairs",), "both named"),
    "a cause outside the catalogue": (("outside strong", "outside weak"), "called unexplained"),
    "no cause, noise of six kinds": (("clean",), "silent"),
    "columns not recorded": (("missing",), "the cause among the rivals, or no name"),
}
"""Machines of the users' page: their lots, and what is right."""
HEAD = """# The lots of simulated machines

Written by `python tests/study/grammar/frozen.py page` from `tests/study/grammar/outcomes`. A generator that shares no code with the
diagnosis draws the machines, from seed 810700 on. Earlier states of the model were judged on them too: 810700 to 810717 helped to
decide on changes, all later changes were decided on other machines.

| Command | What it does |
|---|---|
| `python tests/study/grammar/frozen.py run OUT.jsonl --seeds reporting --first 10900` | adds machines; `--lot` chooses one lot |
| `python tests/study/grammar/frozen.py compare OLD.jsonl NEW.jsonl` | compares two such files |
| `python tests/study/comparison.py --machines 63 --seeds reporting --first 8780` | compares with BIC, lasso, STLSQ and trees |
| `python tests/study/drawn.py` | 40 machines that somebody else drew |

## What was said

A lot is a kind of machine. "From" and "to" are Wilson's interval at 95 %. "Wrong" is a wrong name with a confidence above 0.9.
"""


def summary(outcomes: Sequence[Outcome]) -> list[str]:
    """The rows of the users' page."""
    lines = ["| Machines | of them | right is | right | at least |", "|---|---:|---|---:|---:|"]
    for kind, (lots, what) in KINDS.items():
        hits = [asked(one) for one in outcomes if one["lot"] in lots and "error" not in one]
        found = share(hits)
        lines.append(
            f"| {kind} | {len(hits)} | {what} | {100 * found['share']:.0f} % | {100 * found['wilson_95'][0]:.0f} % |"
        )
    return lines


def _lot(lot: str, own: Sequence[Outcome]) -> str:
    """The row of a lot: shares in %."""
    found = {name: share([hit(one) for one in own]) for name, hit in FIGURES.items()}
    low, high = found["right"]["wilson_95"]
    worst = found["wrong above 0.9"]["wilson_95"][1]
    percent = [found["right"]["share"], low, high, found["wrong above 0.9"]["share"], worst]
    percent += [found[name]["share"] for name in ("unexplained", "silent")]
    return " | ".join([f"| {lot} | {len(own)}", *(f"{100 * one:.0f}" for one in percent)]) + " |"


def _fresh(lot: str, own: Sequence[Outcome]) -> str:
    """The row of a lot: RMS on rows that were not fitted, over that of the true model."""
    ratios = [one["fresh_um"] / one["fresh_true_um"] for one in own if not one["held"]]
    return " | ".join([f"| {lot} | {len(ratios)}", *(f"{one:.2f}" for one in quantiles(ratios).values())]) + " |"


def _runs_asked(outcomes: Sequence[Asked]) -> list[str]:
    """What the runs that were asked for lead to."""
    found = of_runs_asked(outcomes)
    number, confused = found["machines"], found["confused by the standard test"]
    right_share = found["right at the end, of those confused"]
    runs, minutes = (
        found[f"{name} of those confused"] for name in ("runs asked for, mean", "minutes asked for, median")
    )
    return [
        "## The next measurement",
        "",
        f"Of {number:.0f} machines the standard test left {confused:.0f} with more than one possible cause. After {runs:.2f} further",
        f"runs (mean; {minutes:.0f} minutes, median) the cause was right on {100 * right_share:.0f} % of these.",
        "`python tests/study/next_study.py --machines 34 --json OUT.jsonl` prints this.",
        "",
    ]


def page() -> str:
    """`diagnosis_lots.md`."""
    good = [one for one in read(OUTCOMES / "model.jsonl") if "error" not in one]
    lots = {lot: [one for one in good if one["lot"] == lot] for lot in LOTS}
    columns = "Lot | machines | right, % | from | to | wrong, % | to | unexplained, % | silent, %"
    lines = [HEAD, f"| {columns} |", "|---|" + "---:|" * columns.count("|")]
    lines += [_lot(lot, own) for lot, own in lots.items()]
    lines += ["", "## What is left", "", "RMS on fresh rows, divided by what the true model leaves on them.", ""]
    lines += ["| Lot | machines | median | 90 % below | worst |", "|---|---:|---:|---:|---:|"]
    lines += [_fresh(lot, own) for lot, own in lots.items()]
    return "\n".join([*lines, "", *_runs_asked(of_json(OUTCOMES / "next.jsonl"))])


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parts = parser.add_subparsers(dest="what", required=True)
    runs = parts.add_parser("run")
    runs.add_argument("out", type=Path)
    runs.add_argument("--lot", action="append", choices=LOTS)
    runs.add_argument("--seeds", choices=tuple(SEEDS), default="tuning")
    runs.add_argument("--first", type=int, default=0)
    runs.add_argument("--machines", type=int, default=40)
    parts.add_parser("compare").add_argument("files", type=Path, nargs="+")
    parts.add_parser("page")
    args = parser.parse_args(words)
    if args.what == "page":
        PAGE.write_text(page(), encoding="utf-8")
    elif args.what == "compare":
        compare(args.files)
    else:
        run(args.out, args.lot or LOTS, list(SEEDS[args.seeds][args.first : args.first + args.machines]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
