"""What each verb costs before it does anything: seconds and heavy packages loaded, beside an interpreter that loads nothing."""

from __future__ import annotations

import subprocess
import sys
import time
from statistics import median

import pytest

from hil.app.terminal.main import VERBS

HEAVY = ("numpy", "scipy", "matplotlib", "can", "canopen", "pymodbus", "cryptography", "rich", "nicegui", "msgspec")
TIMES = 3
LOOK = (
    "import sys; from hil.app.terminal.main import build_parser\n"
    "build_parser(sys.argv[1:])\n"
    f"print(len(sys.modules), *(name for name in {HEAVY} if name in sys.modules))"
)


def _seconds(code: str, *arguments: str) -> tuple[float, str]:
    """Median of a few runs, and what the last one printed."""
    seconds, printed = [], ""
    for _ in range(TIMES):
        began_s = time.monotonic()
        printed = subprocess.run(
            [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True
        ).stdout
        seconds.append(time.monotonic() - began_s)
    return median(seconds), printed.strip()


@pytest.mark.slow
def test_what_each_verb_loads() -> None:
    empty_s, _ = _seconds("pass")
    print(f"\nan interpreter that loads nothing: {empty_s:.3f} s")
    for verb in ("--help", *VERBS):
        seconds, printed = _seconds(LOOK, verb)
        modules, *heavy = printed.split()
        print(f"{verb:12} {seconds:.2f} s, {seconds / empty_s:5.1f} of that, {modules:>4} modules  {' '.join(heavy)}")
