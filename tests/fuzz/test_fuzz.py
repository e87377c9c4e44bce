"""Every target bears its seeds and the cases found so far; a few seconds of guided fuzzing each with `-m outside`."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import time
from pathlib import Path

import pytest
from fuzz.targets import TARGETS

CASES = Path(__file__).parent / "cases"
SLOWEST_S = 2.0
SHORT_RUNS, SHORT_S = 500, 2


@pytest.mark.parametrize("name", TARGETS)
def test_seeds_and_cases_found_are_borne(name: str) -> None:
    target = TARGETS[name]
    for data in (
        b"",
        *target.seeds,
        *(path.read_bytes() for path in sorted((CASES / name.replace(" ", "_")).glob("*"))),
    ):
        began = time.thread_time()
        target(data)
        assert time.thread_time() - began < SLOWEST_S, data[:200]


def test_every_folder_of_cases_has_a_target() -> None:
    assert {path.name for path in CASES.iterdir() if path.is_dir()} <= {name.replace(" ", "_") for name in TARGETS}


@pytest.mark.outside
@pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="no atheris for this Python")
def test_a_short_run_of_each_target_finds_nothing() -> None:
    command = [sys.executable, str(Path(__file__).parent), "--runs", str(SHORT_RUNS), "--seconds", str(SHORT_S)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:]
    assert done.stdout.count("nothing found") == len(TARGETS)
