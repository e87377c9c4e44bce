"""Work on stored campaigns in a process of its own: python -m hil.app.jobs.worker_process AXIS.toml < request.json

It takes seconds and much memory, and neither the axis's thread nor the pages may notice. The request is an object with `work`
("diagnose", "report", "compare" or "history") and `campaigns`: [[label, [file, …]], …]. The answer on standard output is an object
with `made`, the files that were written, or `error` in one line.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.errors import BridgeError, InputError
from hil.app.error_log import ERRORS, ErrorLog, one_line
from hil.app.report.job import Wanted, make_history, make_report
from hil.axis.axis_file import AxisConfig, load_axis
from hil.diagnosis.stored import stored_beside

DIAGNOSE, REPORT, COMPARE, HISTORY = "diagnose", "report", "compare", "history"
LESS_URGENT = 10
"""Added to the process's niceness: an axis that moves comes first."""


def request(work: str, campaigns: Sequence[Wanted] = ()) -> dict[str, Any]:
    """What this process is asked for, as plain values."""
    return {"work": work, "campaigns": [[one.label, [str(path) for path in one.paths]] for one in campaigns]}


def answer(axis: AxisConfig, asked: dict[str, Any]) -> list[str]:
    """Do it; the files that were written. Raises InputError."""
    wanted = [Wanted(label, tuple(map(Path, paths))) for label, paths in asked["campaigns"]]
    if asked["work"] == DIAGNOSE:
        from hil.diagnosis.job import diagnose_passes  # noqa: PLC0415  (only where it is wanted: slow to import)

        out = stored_beside(wanted[0].paths)
        diagnose_passes(axis, wanted[0].paths, out)
        return [str(out)]
    if asked["work"] in (REPORT, COMPARE):
        return make_report(axis, wanted, compare=asked["work"] == COMPARE)
    if asked["work"] == HISTORY:
        return make_history(axis)
    raise InputError(f"{asked['work']!r} is no work of this process")


def main(path: str) -> int:
    """0 with an answer, 1 with an error."""
    os.nice(LESS_URGENT)
    place = Path(path).parent
    try:
        axis = load_axis(path)
        place = axis.store.directory
        told: dict[str, Any] = {"made": answer(axis, json.load(sys.stdin))}
    except (BridgeError, OSError) as error:
        told = {"error": one_line(error)}
    except Exception as error:  # noqa: BLE001  whoever asked is told where its traceback is
        told = {"error": ErrorLog(place / ERRORS).line_of(error)}
    json.dump(told, sys.stdout)
    return 1 if "error" in told else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
