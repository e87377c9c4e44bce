"""Figures of the diagnosis on random machines: right names, false findings, honesty, held-out worth, coverage.

`python tests/study/own_catalogue.py --machines 520 --report FILE.md` (or .html) runs the whole study and writes the figures beside
their required bounds. With `--json FILE` every outcome is appended as it comes, and an interrupted study is continued from there.
Tests run it with few machines, those marked `outside` with more.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from study.own_catalogue_report import report
from study.truth_machines import DYNAMIC, NOISES, OUTSIDE, STATIC, Machine, Plan

from hil.diagnosis import Diagnosis, diagnose, fit_model
from hil.effects import ALL, Action
from hil.records.rows import Records

INSTRUMENT = frozenset(effect.id for effect in ALL if effect.action is not Action.COMPENSATE)
KINDS = ("strong", "weak", "clean", "outside", "pair", "appeared")
NORMAL_95 = 1.96


@dataclass(frozen=True)
class Case:
    """kind: 'weak', 'strong', 'clean', 'outside', 'pair', 'appeared' (after the table in force was measured)."""

    kind: str
    seed: int
    effects: tuple[str, ...]
    strength: tuple[float, ...]
    noise: str = "normal"
    scatter: str = "jitter"


@dataclass(frozen=True)
class Outcome:
    """Result of the diagnosis of a case; residual figures are relative to the true noise standard deviation.

    rivals: effects named beside the findings
    inside: for each effect found whose true main parameter is known, whether its 95 % interval holds it
    """

    case: Case
    names: tuple[str, ...]
    confidences: tuple[float, ...]
    unexplained: bool
    carriers: tuple[str, ...]
    floor: float
    before: float
    after: float
    fresh: float
    ideal: float
    seconds: float
    inside: tuple[bool, ...] = ()
    rivals: tuple[str, ...] = ()


def cases(per_kind: int, seed: int = 1) -> Iterator[Case]:
    """About `per_kind` cases of each kind, spread evenly over effects and noises."""
    rng = np.random.default_rng(seed)
    for kind, low, high in (("strong", 1.5, 4.0), ("weak", 0.5, 1.5)):
        for i in range(per_kind):
            effect = DYNAMIC[i % len(DYNAMIC)]
            yield Case(kind, int(rng.integers(1 << 30)), (effect,), (float(rng.uniform(low, high)),))
    for i in range(per_kind):
        yield Case("clean", int(rng.integers(1 << 30)), (), (), NOISES[i % len(NOISES)])
    for i in range(per_kind):
        effect = OUTSIDE[i % len(OUTSIDE)]
        yield Case("outside", int(rng.integers(1 << 30)), (effect,), (float(rng.uniform(1.5, 4.0)),))
    for _ in range(per_kind):
        first, second = rng.choice(DYNAMIC, 2, replace=False)
        strengths = (float(rng.uniform(1.5, 4.0)), float(rng.uniform(1.5, 4.0)))
        yield Case("pair", int(rng.integers(1 << 30)), (str(first), str(second)), strengths)
    for i in range(per_kind):
        effect = STATIC[i % len(STATIC)]
        yield Case("appeared", int(rng.integers(1 << 30)), (effect,), (float(rng.uniform(1.5, 4.0)),))


def in_turn(todo: Iterable[Case]) -> list[Case]:
    """The kinds in turn, so that an interrupted study has as many of each."""
    by_kind: dict[str, list[Case]] = {}
    for case in todo:
        by_kind.setdefault(case.kind, []).append(case)
    most = max((len(group) for group in by_kind.values()), default=0)
    return [group[i] for i in range(most) for group in by_kind.values() if i < len(group)]


def run(case: Case) -> Outcome:
    """Diagnose a case, and apply the extended model to a fresh cold campaign of the same machine."""
    machine = Machine(case.seed, case.effects, case.strength, case.noise)
    plan = Plan(scatter=case.scatter)
    columns, parts = machine.campaign(0, plan)
    sigma = float(parts["sigma"])
    declared = None
    if case.kind == "appeared":
        declared = fit_model(Records.of(replace(machine, effects=(), strength=()).campaign(2, plan)[0]))
    started = time.perf_counter()
    diagnosis = diagnose(Records.of(columns), declared)
    seconds = time.perf_counter() - started
    columns, parts = machine.campaign(1, plan)
    fresh = Records.of(columns)
    left = fresh.uncorrected_error_um - diagnosis.extended.error_um(fresh.columns)
    return Outcome(
        case,
        tuple(f.effect for f in diagnosis.findings),
        tuple(round(f.confidence, 4) for f in diagnosis.findings),
        diagnosis.unexplained,
        tuple("×".join(c.columns) for c in diagnosis.carriers),
        diagnosis.noise.within_run_um / sigma,
        diagnosis.before.rms_um / sigma,
        diagnosis.after.rms_um / sigma,
        float(np.sqrt(np.mean(left**2))) / sigma,
        float(np.std(parts["noise"])) / sigma,
        seconds,
        _inside(machine, plan, diagnosis),
        tuple(rival.effect for finding in diagnosis.findings for rival in finding.rivals),
    )


def _inside(machine: Machine, plan: Plan, diagnosis: Diagnosis) -> tuple[bool, ...]:
    true = machine.parameters(plan)
    out: list[bool] = []
    for finding in diagnosis.findings:
        name, value = true.get(finding.effect, ("", 0.0))
        if name in finding.parameters:
            estimate = finding.parameters[name]
            out.append(abs(estimate.value - value) <= NORMAL_95 * estimate.std)
    return tuple(out)


def run_all(todo: Iterable[Case], workers: int, json_lines: Path | None = None) -> list[Outcome]:
    """Every case; with a file, those that are in it already are read from there and the others appended to it."""
    todo = list(todo)
    done = read(json_lines) if json_lines is not None and json_lines.exists() else []
    known = {outcome.case for outcome in done}
    wanted = [case for case in todo if case not in known]
    out = [outcome for outcome in done if outcome.case in set(todo)]
    for outcome in _outcomes(wanted, workers):
        out.append(outcome)
        if json_lines is not None:
            with json_lines.open("a", encoding="utf-8") as file:
                file.write(json.dumps(asdict(outcome)) + "\n")
        if sys.stderr.isatty():
            print(f"\r{len(out)}/{len(todo)}", end="", file=sys.stderr)
    return out


def _outcomes(todo: Sequence[Case], workers: int) -> Iterator[Outcome]:
    if workers <= 1:
        yield from map(run, todo)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        yield from pool.imap_unordered(run, todo, chunksize=4)


def read(json_lines: Path) -> list[Outcome]:
    """The outcomes of a file, one a line."""
    out = []
    for line in json_lines.read_text(encoding="utf-8").splitlines():
        raw = {name: tuple(v) if isinstance(v, list) else v for name, v in json.loads(line).items()}
        case = {name: tuple(v) if isinstance(v, list) else v for name, v in raw.pop("case").items()}
        out.append(Outcome(Case(**case), **raw))
    return out


def _share(hits: Iterable[bool]) -> float:
    values = list(hits)
    return sum(values) / len(values) if values else float("nan")


def summary(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """The figures of the proof."""
    figures: dict[str, float] = {}
    for kind in ("strong", "weak"):
        mine = [o for o in outcomes if o.case.kind == kind]
        if mine:
            figures[f"{kind}: right first"] = _share(o.names[:1] == o.case.effects for o in mine)
            figures[f"{kind}: wrong first"] = _share(bool(o.names) and o.names[0] not in o.case.effects for o in mine)
            figures[f"{kind}: nothing beside it"] = _share(
                set(o.names) <= set(o.case.effects) and not o.unexplained for o in mine
            )
            figures[f"{kind}: called unexplained"] = _share(o.unexplained for o in mine)
    sure = [o for o in outcomes if o.case.kind in ("strong", "weak") and o.names and o.confidences[0] > 0.95]
    if sure:
        figures["confidence above 0.95: right"] = _share(o.names[0] in o.case.effects for o in sure)
    inside = [hit for o in outcomes for hit in o.inside]
    if inside:
        figures["true parameter inside its 95 % interval"] = _share(inside)
    for noise in NOISES:
        mine = [o for o in outcomes if o.case.kind == "clean" and o.case.noise == noise]
        if mine:
            figures[f"clean, {noise}: finding or unexplained"] = _share(bool(o.names) or o.unexplained for o in mine)
    outside = [o for o in outcomes if o.case.kind == "outside"]
    if outside:
        figures["outside: unexplained"] = _share(o.unexplained for o in outside)
        figures["outside: confident name"] = _share(any(c > 0.9 for c in o.confidences) for o in outside)
    pairs = [o for o in outcomes if o.case.kind == "pair"]
    if pairs:
        figures["pair: both"] = _share(set(o.case.effects) <= set(o.names) for o in pairs)
        figures["pair: only both"] = _share(set(o.case.effects) == set(o.names) and not o.unexplained for o in pairs)
    appeared = [o for o in outcomes if o.case.kind == "appeared"]
    if appeared:
        # a misaligned beam and a lead error are equal in any records: there, naming it beside the lead error is right
        figures["appeared: right first"] = _share(
            o.names[:1] == o.case.effects or (o.case.effects[0] == "cosine" and "cosine" in o.rivals) for o in appeared
        )
    known = [o for o in outcomes if o.case.kind in ("strong", "weak", "pair") and not INSTRUMENT & set(o.case.effects)]
    if known:
        ratio = np.array([o.fresh / o.ideal for o in known])
        figures["fresh RMS over noise: median"] = float(np.median(ratio))
        figures["fresh RMS over noise: 90 %"] = float(np.quantile(ratio, 0.9))
    figures["seconds: median"] = float(np.median([o.seconds for o in outcomes]))
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=104, help="machines of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--scatter", default="jitter")
    parser.add_argument("--json", type=Path, help="append every outcome here as it comes, one a line; continue from it")
    parser.add_argument("--report", type=Path, help="write the figures here, .md or .html")
    args = parser.parse_args()
    wanted = args.kinds.split(",")
    todo = [case for case in cases(args.machines, args.seed) if case.kind in wanted]
    todo = in_turn(Case(**{**asdict(case), "scatter": args.scatter}) for case in todo)
    outcomes = run_all(todo, args.workers, args.json)
    figures = summary(outcomes)
    for name, value in figures.items():
        print(f"{name:45s} {value:8.3f}")
    if args.report:
        how = f"--machines {args.machines} --seed {args.seed} --scatter {args.scatter}"
        by_effect = [(o.case.kind, o.case.effects, o.case.noise, o.names, o.unexplained) for o in outcomes]
        args.report.write_text(report(figures, by_effect, how, args.report.suffix == ".html"), encoding="utf-8")


if __name__ == "__main__":
    main()
