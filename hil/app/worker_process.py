"""Program of the worker process: python -m hil.app.worker_process AXIS.toml < request.json

It computes on stored campaigns for seconds and with much memory, without delaying the axis's thread or the pages. The request is an
object with `work` ("diagnose", "report", "compare" or "history") and `campaigns`: [[label, [file, …]], …]. The answer on standard
output is an object with `made`, the files written, or `error`, one line.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.errors import BridgeError, InputError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.desk.error_log import ERRORS, ErrorLog, one_line
from hil.diagnosis.stored import stored_beside
from hil.report.job import Wanted, make_history, make_report

DIAGNOSE, REPORT, COMPARE, HISTORY = "diagnose", "report", "compare", "history"
LESS_URGENT = 10
"""Added to the process's niceness, so that the axis's thread runs first."""


def request(work: str, campaigns: Sequence[Wanted] = ()) -> dict[str, Any]:
    """A request to this process, as plain values."""
    return {"work": work, "campaigns": [[one.label, [str(path) for path in one.paths]] for one in campaigns]}


def answer(axis: AxisConfig, asked: dict[str, Any]) -> list[str]:
    """Do the work; returns the files written. Raises InputError for unknown work, and what the work raises."""
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
    """Exit status 0 with `made`, 1 with `error`."""
    os.nice(LESS_URGENT)
    place = Path(path).parent
    try:
        axis = load_axis(path)
        place = axis.store.directory
        result: dict[str, Any] = {"made": answer(axis, json.load(sys.stdin))}
    except (BridgeError, OSError) as error:
        result = {"error": one_line(error)}
    except Exception as error:  # noqa: BLE001  whoever asked is result where its traceback is
        result = {"error": ErrorLog(place / ERRORS).line_of(error)}
    json.dump(result, sys.stdout)
    return 1 if "error" in result else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
