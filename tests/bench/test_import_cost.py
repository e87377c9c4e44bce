"""What each verb's help costs: processor time and heavy packages, beside an interpreter that loads nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from statistics import median

import pytest
from support.bench import Record, installed, median_ratio, row

from hil.app.main import VERBS

HEAVY = (
    "numpy",
    "scipy.special",
    "matplotlib",
    "can",
    "canopen",
    "pymodbus",
    "cryptography",
    "rich",
    "nicegui",
    "msgspec",
)
TIMES = 3
LOOK = (
    "import sys; from hil.app.main import build_parser\n"
    "build_parser(sys.argv[1:])\n"
    f"print(len(sys.modules), *(name for name in {HEAVY} if name in sys.modules))"
)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return installed(tmp_path_factory.mktemp("compiled"))


def _ran(env: dict[str, str], code: str, *arguments: str) -> tuple[float, str]:
    """Processor seconds of a process that runs this, and what it printed."""
    words = [sys.executable, "-c", code, *arguments]
    with subprocess.Popen(words, env=env, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        printed = process.stdout.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    return used.ru_utime + used.ru_stime, printed.strip()


@pytest.mark.parametrize("verb", ["--help", *VERBS])
def test_start_of_a_verb(verb: str, compiled: dict[str, str], record_property: Record) -> None:
    """Beside an interpreter that loads nothing, in turn."""
    _ran(compiled, LOOK, verb)
    rounds = [(*_ran(compiled, LOOK, verb), _ran(compiled, "pass")[0]) for _ in range(TIMES)]
    mine, empty = [one[0] for one in rounds], [one[2] for one in rounds]
    modules, *heavy = rounds[-1][1].split()
    print(f"\n{modules} modules, among them {' '.join(heavy) or 'no heavy one'}")
    row(
        record_property,
        f"start of hil {verb}",
        1000.0 * median(mine),
        1000.0 * median(empty),
        "ms",
        beside="an interpreter",
        ratio=median_ratio(mine, empty),
        asked="≤ 8",
    )
