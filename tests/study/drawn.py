"""Figures of the diagnosis on machines drawn by another hand (`drawn/N` of the shared data: train, fresh, truth).

`python tests/study/drawn.py [FOLDER] [--only 9008,9120] [--json LINES]` diagnoses each machine through the job of `hil diagnose` and
prints what was said beside what was put in. These machines are examples: nothing is tuned to them, and they are no proof.
"""

from __future__ import annotations

import argparse
import gzip
import json
import os
import re
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hil.diagnosis import Finding
from hil.diagnosis.follow_up import diagnosed
from hil.effects import ALL
from hil.records.rows import Records, parse_csv

ROOT = Path(__file__).resolve().parents[2]
FOLDER = Path(os.environ.get("HIL_SHARED_DATA", ROOT.parent / "shared" / "data")) / "drawn"
WEAK, STRONG, MOST = 0.5, 1.5, 4.0
"""Bounds of the ratio: RMS of the cause over the standard deviation of the noise."""
CONFIDENT = 0.9
BOUNDS = ("least_", "most_", "shortest_")
POSITIVE = re.compile(r"period|length|width|lag_s|lag_rows|time_constant|knee|angle")
MOST_OVER_PEAK = 2.5
"""Half of an amount (it may be told from one side to the other), over the largest contribution to a row."""


def rows_of(path: Path) -> Records:
    """Records of a compressed file."""
    return parse_csv(gzip.decompress(path.read_bytes()).decode(), path)


def outcome(folder: Path) -> dict[str, Any]:
    """What was said of one machine, with what was put in."""
    truth = json.loads((folder / "truth.json").read_text())
    train, fresh = rows_of(folder / "train.csv.gz"), rows_of(folder / "fresh.csv.gz")
    started = time.perf_counter()
    diagnosis = diagnosed(train, None, ALL).diagnosis
    seconds = time.perf_counter() - started
    left_um = fresh.uncorrected_error_um - diagnosis.extended.error_um(fresh.columns)
    left_um = left_um - float(np.mean(left_um)) if truth["effect"] == "datum_step" else left_um
    return {
        "machine": int(folder.name),
        "effect": truth["effect"],
        "ratio": truth["ratio"],
        "names": [f.effect for f in diagnosis.findings],
        "figures": [{n: (e.value, e.std) for n, e in f.parameters.items()} for f in diagnosis.findings],
        "cannot_be": [said for f in diagnosis.findings for said in cannot_be(f)],
        "confidences": [round(f.confidence, 3) for f in diagnosis.findings],
        "unexplained": diagnosis.unexplained,
        "carriers": [str(carrier) for carrier in diagnosis.carriers],
        "noise_floor": diagnosis.to_json()["noise_floor_um"],
        "noise": truth["noise_um"],
        "after": diagnosis.after.rms_um / truth["noise_um"],
        "fresh": float(np.sqrt(np.mean(left_um**2))) / truth["noise_um"],
        "seconds": round(diagnosis.seconds, 2),
        "job_seconds": round(seconds, 2),
        "notes": list(diagnosis.notes),
    }


def cannot_be(finding: Finding) -> Iterator[str]:
    """The figures of a finding that no measurement can have given: an interval of a positive quantity which holds zero, an
    amount in µm far beyond what the effect contributes to the rows or as uncertain, and an uncertainty of nothing.
    """
    for name, found in finding.parameters.items():
        bound = name.startswith(BOUNDS)
        doubts = (
            not np.isfinite([found.value, found.std]).all(),
            not bound and found.std == 0.0,
            not bound and POSITIVE.search(name) and found.std > 0.5 * found.value,
            name.endswith("_um") and max(abs(found.value) / 2.0, found.std) > MOST_OVER_PEAK * finding.peak_um,
        )
        if any(doubts):
            yield f"{finding.effect} {name} {found}"


def kind_of(one: dict[str, Any]) -> str:
    """clean, outside, strong or weak."""
    if one["effect"] == "clean":
        return "clean"
    if one["effect"].startswith("alien"):
        return "outside"
    return "strong" if one["ratio"] >= STRONG else "weak"


def right(one: dict[str, Any]) -> bool:
    """Whether what was said first is what was put in."""
    kind = kind_of(one)
    if kind == "clean":
        return not one["names"] and not one["unexplained"]
    if kind == "outside":
        return bool(one["unexplained"])
    return one["names"][:1] == [one["effect"]]


def summary(outcomes: Sequence[dict[str, Any]]) -> dict[str, str]:
    """The figures, with the numbers of machines."""
    found = {}
    for kind in ("strong", "weak", "outside", "clean"):
        mine = [one for one in outcomes if kind_of(one) == kind]
        found[kind] = f"{sum(map(right, mine))} of {len(mine)} right"
    wrong = [
        one["machine"]
        for one in outcomes
        if any(c > CONFIDENT and n != one["effect"] for n, c in zip(one["names"], one["confidences"], strict=True))
    ]
    found[f"a wrong name above {CONFIDENT}"] = f"{len(wrong)} of {len(outcomes)}: {wrong}"
    fresh = np.array([one["fresh"] for one in outcomes])
    found["fresh RMS / noise, median, 90 %, worst"] = ", ".join(f"{np.quantile(fresh, q):.3f}" for q in (0.5, 0.9, 1.0))
    wrong_figures = [said for one in outcomes for said in one["cannot_be"]]
    found["figures that cannot be"] = f"{len(wrong_figures)}: {'; '.join(wrong_figures)}"
    floors = [one["noise_floor"] / one["noise"] for one in outcomes if one["noise_floor"] is not None]
    quantiles = ", ".join(f"{np.quantile(floors, q):.2f}" for q in (0.0, 0.5, 0.9, 1.0)) if floors else "none"
    found[f"noise floor / noise ({len(floors)} have one): least, median, 90 %, largest"] = quantiles
    found["seconds, median, largest"] = ", ".join(
        f"{q:.2f}" for q in np.quantile([o["seconds"] for o in outcomes], (0.5, 1))
    )
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=FOLDER)
    parser.add_argument("--only", default="", help="machines, by comma")
    parser.add_argument("--json", type=Path, help="append every outcome here, one a line")
    args = parser.parse_args()
    only = [name for name in args.only.split(",") if name]
    outcomes = []
    for folder in sorted(path.parent for path in args.folder.glob("*/truth.json")):
        if only and folder.name not in only:
            continue
        one = outcome(folder)
        outcomes.append(one)
        mark = "+" if right(one) else "-"
        said = " ".join(f"{n} {c}" for n, c in zip(one["names"], one["confidences"], strict=True))
        left = f" unexplained: {'; '.join(one['carriers'])}" if one["unexplained"] else ""
        print(
            f"{mark} {one['machine']} {one['effect']:18s} {one['ratio']:.2f} | {said}{left} | fresh {one['fresh']:.2f}"
            f" floor {one['noise_floor'] or float('nan'):.2f} of {one['noise']:.2f}",
            flush=True,
        )
        if args.json:
            with args.json.open("a", encoding="utf-8") as file:
                file.write(json.dumps(one) + "\n")
    for name, value in summary(outcomes).items():
        print(f"{name}: {value}")


if __name__ == "__main__":
    main()
