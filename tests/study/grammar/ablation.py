"""What each part of the model and each number of its policy moves: verdicts on tuning machines without the part, or with the number
changed, beside those as it stands.

`python tests/study/grammar/ablation.py OUT.jsonl --machines 6` goes on where OUT ends and prints the table; `--page` writes it to
ablation.md, `--only` names some, `--together "richer forms + largest 1e9"` changes all of these at once.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any
from unittest.mock import patch

if not __package__:  # run as a file: its own place would hide the package
    sys.path[0] = str(Path(__file__).resolve().parents[2])

import numpy as np
from study.grammar.frozen import asked, compact
from study.grammar.judge import Outcome, outcome
from study.grammar.machine import LOTS, SEEDS

from hil.diagnosis.model import evidence, verdict
from hil.diagnosis.model.candidates import Catalogue
from hil.diagnosis.model.diagnosing import Case, InForce
from hil.diagnosis.model.evidence import Noise
from hil.diagnosis.model.policy import USUAL
from hil.diagnosis.model.remainder import Remainder
from hil.diagnosis.model.rows import NO_MEMORY
from hil.diagnosis.model.search import Search

FACTORS = (0.5, 2.0)
PARTS: Mapping[str, tuple[Any, str, Any]] = {
    "rivals by physics": (verdict, "not_told_apart", lambda *_: {}),
    "unlogged causes": (verdict, "unlogged", lambda *_: ()),
    "one run, or row in n": (Remainder, "_of_rows", lambda *_: ()),
    "states in time": (Remainder, "_in_time", lambda *_: ()),
    "waves along the travel": (Remainder, "_along", lambda *_: ()),
    "effects for a remainder": (Search, "_effects_instead", lambda *_: None),
    "refusal of few rows": (Search, "rests_on_few", lambda *_: False),
    "physical ranges": (Search, "_against", lambda *_: 0.0),
    "usual offsets": (Noise, "has_large_offsets", False),
    "refined parameters": (Catalogue, "refined", lambda _, ranked: ranked),
    "richer forms": (Catalogue, "richer", lambda *_: ()),
    "relay as a rival": (verdict.Verdict, "_switched", lambda *_: ""),
    "suspected cause": (Case, "_suspected", lambda case: case._nothing()),
    "bounded temperature": (Case, "_bounded", lambda _, live: dict(live)),
    "what a table absorbed": (Catalogue, "_ways", lambda *_: (False,)),
    "size between the rows": (Catalogue, "between_rows", lambda *_: 1.0),
    "memory of noise": (evidence, "MEMORIES", (NO_MEMORY,)),
    "required gain": (Case, "_with_gain", lambda _, taken: taken),
}
"""Parts that can be left out, and what stands in their place."""


@contextmanager
def number(name: str, factor: float) -> Iterator[None]:
    """A number of the policy times a factor."""
    usual = getattr(USUAL, name)
    object.__setattr__(USUAL, name, usual * factor)
    try:
        yield
    finally:
        object.__setattr__(USUAL, name, usual)


def variants(only: Sequence[str], together: str) -> list[str]:
    """As it stands, and changed together, or without each part and with each number halved and doubled."""
    if together:
        return ["", together]
    changed = [*PARTS, *(f"{name} {factor:g}" for name in asdict(USUAL) for factor in FACTORS)]
    return ["", *(one for one in changed if not only or one in only or one.split(" ")[0] in only)]


@contextmanager
def watched() -> Iterator[set[str]]:
    """The parts that did something meanwhile: without the others the same would have been said."""
    moved: set[str] = set()

    def beside(name: str, usual: Any, instead: Any) -> Any:
        def call(*args: Any) -> Any:
            given = usual(*args)
            given = tuple(given) if isinstance(given, Iterator) else given
            if name not in moved and not _same(given, instead(*args)):
                moved.add(name)
            return given

        return call

    with ExitStack() as changed:
        for name, (owner, attribute, instead) in PARTS.items():
            usual = getattr(owner, attribute)
            if not callable(usual) and not isinstance(usual, property):
                moved.add(name)
                continue
            if isinstance(usual, property):
                new: Any = property(beside(name, usual.fget, lambda _, value=instead: value))
            else:
                new = beside(name, usual, instead)
            changed.enter_context(patch.object(owner, attribute, new))
        yield moved


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, np.ndarray):
        return bool(np.array_equal(one, other))
    if isinstance(one, InForce):
        return one.force is other.force
    return one is other or bool(one == other)


def judged(lot: str, seed: int, variant: str) -> Outcome:
    """The outcome of one machine with a variant of the model."""
    with ExitStack() as changed:
        for one in filter(None, variant.split(" + ")):
            if one in PARTS:
                changed.enter_context(patch.object(*PARTS[one]))
            else:
                name, factor = one.split(" ")
                changed.enter_context(number(name, float(factor)))
        return outcome(lot, seed)


def _said(one: Outcome) -> object:
    said = one["said"]
    return said["unexplained"], [(effect, confidence > 0.9) for effect, confidence, _ in said["findings"]]


def summary(lines: Sequence[Outcome]) -> list[dict[str, Any]]:
    """Of each variant beside the model as it stands: machines, those on which anything is said otherwise, verdicts that change, right
    and wrong ones more, fresh errors less and more by 2 %.
    """
    by_variant: dict[str, dict[tuple[str, int], Outcome]] = {}
    for one in lines:
        if "error" not in one:
            by_variant.setdefault(one["variant"], {})[one["lot"], one["seed"]] = one
    usual = by_variant.pop("", {})
    found = []
    for variant, own in by_variant.items():
        pairs = [(usual[key], one) for key, one in own.items() if key in usual]
        found.append(
            {
                "variant": variant,
                "machines": len(pairs),
                "moved": sum(_all(a) != _all(b) for a, b in pairs),
                "verdicts": sum(_said(a) != _said(b) for a, b in pairs),
                "right": sum(int(asked(b)) - int(asked(a)) for a, b in pairs),
                "wrong": sum(bool(b["confident_wrong"]) - bool(a["confident_wrong"]) for a, b in pairs),
                "better": sum(b["fresh_um"] < 0.98 * a["fresh_um"] for a, b in pairs),
                "worse": sum(b["fresh_um"] > 1.02 * a["fresh_um"] for a, b in pairs),
            }
        )
    return found


def _all(one: Outcome) -> object:
    told = {name: value for name, value in one["said"].items() if name != "seconds"}
    return told, one["fresh_um"]


PAGE = Path(__file__).parent / "ablation.md"
HEAD = """# What each part of the model and each number moves

Tuning machines, judged without a part of [the model](../../../hil/docs/model.md), or with a number halved or doubled.
Moved: anything is said otherwise.
Right, wrong: so many machines more. Fresh: 2 % less or more is left on fresh rows.
`python tests/study/grammar/ablation.py OUT.jsonl --first 700 --machines 20 --page` writes this of the machines that OUT has.
"""


HEADS = ("without, or number ×", "machines", "moved", "verdicts", "right", "wrong", "fresh better", "worse")


def moved(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The table of what each part and each number moves."""
    lines = [f"| {' | '.join(HEADS)} |", "|---|" + "---:|" * (len(HEADS) - 1)]
    for one in rows:
        signed = (f"{one['right']:+d}", f"{one['wrong']:+d}")
        cells = (one["variant"], one["machines"], one["moved"], one["verdicts"], *signed, one["better"], one["worse"])
        lines.append(f"| {' | '.join(map(str, cells))} |")
    return lines


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--machines", type=int, default=6)
    parser.add_argument("--lot", action="append", choices=LOTS)
    parser.add_argument("--only", action="append", default=[], help="a part or a number")
    parser.add_argument("--page", action="store_true", help="write the table to ablation.md")
    parser.add_argument("--together", default="", help="parts and numbers with their factors, joined by +")
    args = parser.parse_args(words)
    trials = variants(args.only, args.together)
    lines = [json.loads(line) for line in args.out.read_text().splitlines()] if args.out.exists() else []
    done = {(one["lot"], one["seed"], one["variant"]) for one in lines}
    for seed in SEEDS["tuning"][args.first : args.first + args.machines]:
        for lot in args.lot or LOTS:
            if all((lot, seed, variant) in done for variant in trials):
                continue
            with watched() as acted:
                usual = compact(judged(lot, seed, ""))
            for variant in trials:
                if (lot, seed, variant) in done:
                    continue
                is_moved = variant not in PARTS or variant in acted
                found = (compact(judged(lot, seed, variant)) if variant and is_moved else usual) | {"variant": variant}
                with args.out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(found) + "\n")
                lines.append(found)
    found = summary(lines)
    print("\n".join(moved(found)))
    if args.page:
        PAGE.write_text("\n".join([HEAD, *moved(found), ""]), encoding="utf-8")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
