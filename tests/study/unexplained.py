"""The diagnosis of machines whose error is in no catalogue: its stated size, and the benefit of a correction without a cause.

`python tests/study/unexplained.py --machines 10` prints for each kind of machine how often an error was called unexplained, how often
the stated 95 % interval of the RMS that the columns carry holds the true one, and the RMS over the noise on a fresh cold campaign:
with the extended model, and with the smooth function that `--non-parametric` adds, where that was not refused.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from study.truth_machines import OUTSIDE, Machine, Plan

from hil.diagnosis import Diagnosis, diagnose
from hil.records.rows import Records

NORMAL_95 = 1.96


@dataclass(frozen=True)
class Outcome:
    """size: of the largest carrier over the true RMS, and half its 95 % interval

    fresh: RMS over the noise of a fresh campaign; corrected: the same with the correction without a cause, None where that was
    refused for the reason given
    """

    kind: str
    unexplained: bool
    size: tuple[float, float] | None
    fresh: float
    corrected: float | None
    refused: str


def run(kind: str, seed: int, strength: float) -> Outcome:
    """Diagnose one machine; the true RMS is over the rows of the campaign, beside a straight line in each direction."""
    machine = Machine(seed, (kind,), (strength,))
    columns, parts = machine.campaign(0, Plan())
    diagnosis = diagnose(Records.of(columns))
    line = np.column_stack([np.ones(len(columns["run"])), columns["target_mm"]])
    table = np.hstack([line, line * columns["direction"][:, None]])
    true_um = float(np.std(parts[kind] - table @ np.linalg.lstsq(table, parts[kind], rcond=None)[0]))
    largest = max(diagnosis.carriers, key=lambda carrier: carrier.rms.value, default=None)
    size = None if largest is None else (largest.rms.value / true_um, NORMAL_95 * largest.rms.std / true_um)
    columns, parts = machine.campaign(1, Plan())
    fresh, noise_um = Records.of(columns), float(np.std(parts["noise"]))

    def left(found: Diagnosis) -> float:
        rest = fresh.uncorrected_error_um - found.extended.error_um(fresh.columns)
        return float(np.sqrt(np.mean(rest**2))) / noise_um

    offer = diagnosis.non_parametric
    refused = isinstance(offer, str)
    return Outcome(
        kind,
        diagnosis.unexplained,
        size,
        left(diagnosis),
        None if isinstance(offer, str) else left(offer),
        str(offer) if refused else "",
    )


def outcomes(machines: int, seed: int = 1, kinds: Sequence[str] = OUTSIDE) -> Iterator[Outcome]:
    """So many machines of each kind, at 1.5 to 4 times the noise."""
    rng = np.random.default_rng(seed)
    for _ in range(machines):
        for kind in kinds:
            yield run(kind, int(rng.integers(1 << 30)), float(rng.uniform(1.5, 4.0)))


def summary(found: Sequence[Outcome]) -> dict[str, float]:
    """The figures of some outcomes; those with the correction are over the machines that have one."""
    sizes = [one.size for one in found if one.size is not None]
    pairs = [(one.fresh, one.corrected) for one in found if one.corrected is not None]
    figures = {
        "unexplained": float(np.mean([one.unexplained for one in found])),
        "size inside": float(np.mean([abs(size - 1.0) <= half for size, half in sizes])) if sizes else float("nan"),
        "size, median": float(np.median([size for size, _ in sizes])) if sizes else float("nan"),
        "refused": float(np.mean([one.corrected is None for one in found])),
    }
    if pairs:
        before, after = np.array(pairs).T
        figures |= {
            "fresh, median": float(np.median(before)),
            "corrected, median": float(np.median(after)),
            "corrected is better": float(np.mean(after < before)),
            "worst ratio": float(np.max(after / before)),
        }
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=10, help="machines of each kind")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    found: list[Outcome] = []
    for one in outcomes(args.machines, args.seed):
        found.append(one)
        print(one, flush=True)
    for kind in (*OUTSIDE, "all"):
        mine = [one for one in found if kind in (one.kind, "all")]
        print(f"{kind:26s} " + "  ".join(f"{name} {value:.2f}" for name, value in summary(mine).items()))


if __name__ == "__main__":
    main()
