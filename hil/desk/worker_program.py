"""Program of the worker process: python -m hil.desk.worker_program AXIS.toml < request.json

It computes on stored campaigns for seconds and with much memory, without delaying the axis's thread or the pages. The request is that
of `hil.desk.worker_process.Work`. The answer on standard output is an object with `made`, the files written, or `error`, one line.
"""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from drivers.errors import BridgeError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.desk.error_log import ERRORS, ErrorLog, one_line
from hil.desk.worker_process import Passes

LESS_URGENT = 10
"""Added to the process's niceness, so that the axis's thread runs first."""


def answer(axis: AxisConfig, asked: dict[str, Any]) -> list[str]:
    """Call the function that the request names; returns the files written. Raises what the function raises."""
    module, _, name = asked["function"].partition(":")
    campaigns = [Passes(label, tuple(map(Path, paths))) for label, paths in asked["campaigns"]]
    return list(getattr(import_module(module), name)(axis, campaigns))


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
    except Exception as error:  # noqa: BLE001  the answer names the file with its traceback
        result = {"error": ErrorLog(place / ERRORS).line_of(error)}
    json.dump(result, sys.stdout)
    return 1 if "error" in result else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
