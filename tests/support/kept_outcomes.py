"""Outcomes of the grammar's machines, diagnosed once for all tests, processes and runs that ask something of them.

They are kept in pytest's cache under a digest of what decides them: the program, the generator, the judge and the numeric libraries.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import shutil
import sys
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import scipy
from study.grammar.judge import Outcome, outcome
from study.grammar.machine import SEEDS

from hil.fleet.executor import completed

ROOT = Path(__file__).parents[2]


def outcomes(cache: Path, machines: Mapping[str, int], *, fresh: bool) -> dict[str, list[Outcome]]:
    """The first so many tuning machines of each lot. cache: a directory for this alone; fresh: diagnose, whatever is kept."""
    cache.mkdir(parents=True, exist_ok=True)
    with (cache / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        place = cache / _digest()
        if fresh or not place.exists():
            for older in (path for path in cache.iterdir() if path.is_dir()):
                shutil.rmtree(older)
        place.mkdir(exist_ok=True)
        return {lot: _of_lot(place, lot, SEEDS["tuning"][:number]) for lot, number in machines.items()}


def _of_lot(place: Path, lot: str, seeds: Iterable[int]) -> list[Outcome]:
    files = {seed: place / f"{lot}-{seed}.json" for seed in seeds}
    missing = [seed for seed, path in files.items() if not path.exists()]
    for seed, found in completed(partial(outcome, lot), missing, processes=2):
        files[seed].write_text(json.dumps(found))
    return [json.loads(path.read_text()) for path in files.values()]


def _digest() -> str:
    digest = hashlib.sha256(f"{sys.version} {np.__version__} {scipy.__version__}".encode())
    for directory in ("hil", "drivers", "tests/study/grammar", "tests/support"):
        for path in sorted((ROOT / directory).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
