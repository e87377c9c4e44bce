"""What each number of the policy moves: verdicts on tuning machines with the number halved and doubled, beside those as it stands.

`python tests/study/grammar/ablation.py OUT.jsonl --machines 30` goes on where OUT ends and prints the table.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

if not __package__:  # run as a file: its own place would hide the package
    sys.path[0] = str(Path(__file__).resolve().parents[2])

from study.grammar.equivalence import always_there, not_wrong, right_names
from study.grammar.machine import LOTS, SEEDS, draw

from hil.diagnosis import diagnose, fit_model
from hil.diagnosis.model.policy import USUAL
from hil.records.rows import Records

FACTORS = (0.5, 2.0)


def variants() -> Iterator[tuple[str, float]]:
    """Each number with its factor; none first."""
    yield "", 1.0
    for name in asdict(USUAL):
        yield from ((name, factor) for factor in FACTORS)


def verdict(lot: str, seed: int, name: str, factor: float) -> dict[str, Any]:
    """Names with their confidences, whether something is unexplained, and the RMS of what runs left out keep."""
    drawn = draw(lot, seed)
    declared = None if drawn.older is None else fit_model(Records.of(drawn.older.records))
    if name:
        usual = getattr(USUAL, name)
        object.__setattr__(USUAL, name, usual * factor)
    try:
        found = diagnose(Records.of(drawn.fit.records), declared)
    finally:
        if name:
            object.__setattr__(USUAL, name, usual)
    courses = [cause["course_of_time"] for cause in drawn.truth()["causes"]]  # type: ignore[index, attr-defined]
    rights = [right_names(cause, drawn.removed, one) for cause, one in zip(drawn.causes, courses, strict=True)]
    tolerated = frozenset().union(
        *rights, *(not_wrong(cause) for cause in drawn.causes), always_there(drawn.older is not None)
    )
    names = [finding.effect for finding in found.findings]
    is_right = not names and not found.unexplained
    if lot.startswith("outside"):
        is_right = found.unexplained
    elif lot != "clean":
        is_right = bool(names) and names[0] in rights[0] and all(set(names) & right for right in rights)
    return {
        "names": names,
        "sure": [finding.confidence > 0.9 for finding in found.findings],
        "unexplained": found.unexplained,
        "right": bool(is_right),
        "wrong": any(f.confidence > 0.9 and f.effect not in tolerated for f in found.findings),
        "after_um": found.after.rms_um,
    }


def table(lines: Sequence[dict[str, Any]]) -> None:
    """Of each number and factor: machines, verdicts that change, right and wrong ones, and corrections that change by 2 %."""
    usual = {(one["lot"], one["seed"]): one for one in lines if not one["number"]}
    print(f"as it stands: {len(usual)} machines, right {sum(one['right'] for one in usual.values())}")
    print("| number | factor | machines | verdicts changed | right | wrong above 0.9 | corrections changed by 2 % |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for name, factor in variants():
        own = [one for one in lines if one["number"] == name and one["factor"] == factor and name]
        count: Counter[str] = Counter()
        for one in own:
            before = usual[one["lot"], one["seed"]]
            count["changed"] += any(one[key] != before[key] for key in ("names", "sure", "unexplained"))
            count["right"] += int(one["right"]) - int(before["right"])
            count["wrong"] += int(one["wrong"]) - int(before["wrong"])
            count["corrected"] += abs(one["after_um"] / before["after_um"] - 1.0) > 0.02
        if own:
            print(
                f"| {name} | {factor:g} | {len(own)} | {count['changed']} | {count['right']:+d} | {count['wrong']:+d}"
                f" | {count['corrected']} |"
            )


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--machines", type=int, default=30)
    args = parser.parse_args(words)
    lines = [json.loads(line) for line in args.out.read_text().splitlines()] if args.out.exists() else []
    done = {(one["lot"], one["seed"], one["number"], one["factor"]) for one in lines}
    for seed in SEEDS["tuning"][args.first : args.first + args.machines]:
        for lot in LOTS:
            for name, factor in variants():
                if (lot, seed, name, factor) in done:
                    continue
                found = {"lot": lot, "seed": seed, "number": name, "factor": factor} | verdict(lot, seed, name, factor)
                with args.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(found) + "\n")
                lines.append(found)
    table(lines)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
