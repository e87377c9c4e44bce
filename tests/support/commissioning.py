"""A machine in one process and its commissioning in others, as in a workshop: helpers for tests of real processes."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from support.bench_axis import PASSWORDS

from hil.app.main import main
from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key
from hil.records.rows import Records, read_csv

PATIENCE_S = 600.0 if os.environ.get("HIL_VCAN") == "guest" else 90.0
"""Longest wait for another process on a busy host, s; in the guest Python starts slowly."""

PATIENT = {
    "canopen": "sdo_timeout_s = 5.0\nsample_timeout_s = 5.0\nheartbeat_s = 2.0\nguard_s = 6.0",
    "modbus": "",
}

MEASUREMENT = """[measurement]
targets_mm = {targets}
runs = 1
velocity_mm_s = {velocity}
dwell_s = 0.1
reading_s = 0.2
"""


def shortened(path: Path, *, targets: str = "[2.0, 17.0, 32.0]", velocity: float = 20.0, drive: str = "") -> None:
    """Turn an axis file for a process of its own into one with short measurements and long time-outs."""
    text = path.read_text(encoding="utf-8")
    text = text[: text.index("[measurement]")] + MEASUREMENT.format(targets=targets, velocity=velocity)
    backend = re.search(r'backend = "(\w+)"', text)
    assert backend is not None
    text = text.replace("[drive]\n", f"[drive]\n{PATIENT[backend[1]]}\n{drive}\n")
    if backend[1] == "modbus":
        text = re.sub(r'(url = "[^"?]*)\??', r"\1?timeout_s=5&", text)
    path.write_text(text.replace("[instrument]\n", "[instrument]\nstale_after_s = 3.0\n"), encoding="utf-8")


def prepare(path: Path, *, targets: str = "[2.0, 17.0, 32.0]", velocity: float = 20.0, drive: str = "") -> None:
    """An axis file as by `shortened`, with the builder's keys beside it."""
    shortened(path, targets=targets, velocity=velocity, drive=drive)
    key = new_key()
    cost = Cost(n=1 << 10, r=8, p=1)
    save_private_key(path.with_name("builder.key"), key, PASSWORDS["HIL_KEY_PASSWORD"], cost=cost)
    save_public_key(path.with_name("builder.pub"), key.public_key())


def rows_of(path: Path, name: str = "measure") -> int:
    """Number of complete rows of a pass, of the last campaign of an axis file; 0 while there is none."""
    found = sorted(path.parent.glob(f"X-campaign/calibrate-*/{name}.csv"))
    if not found:
        return 0
    lines = found[-1].read_text(encoding="utf-8").splitlines(keepends=True)
    return max(0, sum(line.endswith("\n") and not line.startswith("#") for line in lines) - 1)


def kept(path: Path, name: str = "measure") -> Records:
    """The rows of a pass of the last campaign."""
    return read_csv(sorted(path.parent.glob(f"X-campaign/calibrate-*/{name}.csv"))[-1])


def wait_for(condition: Callable[[], bool], what: str, *, unless_ended: subprocess.Popen[str] | None = None) -> None:
    """Wait for another process; fails after PATIENCE_S seconds, or when a process that should run has ended
    (AssertionError)."""
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        if unless_ended is not None and unless_ended.poll() is not None:
            raise AssertionError(f"ended with {unless_ended.returncode} before {what}: {unless_ended.communicate()}")
        if time.monotonic() > deadline:
            raise AssertionError(f"not within {PATIENCE_S:g} s: {what}")
        time.sleep(0.02)


class Job:
    """`hil VERB …` in a process of its own."""

    def __init__(self, *arguments: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "hil.app.main", *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, **PASSWORDS},
        )

    def __enter__(self) -> Job:
        return self

    def __exit__(self, *_exc: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def ended(self) -> tuple[int, str]:
        """Exit status and text on stderr, once it has ended by itself."""
        _, errors = self.process.communicate(timeout=PATIENCE_S)
        return self.process.returncode, errors


def look(place: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """State and position of the machine's drive as `hil scan` reports them, in counts or raw."""
    if place["backend"] == "modbus":
        where = ["--tcp", place["url"], "--units", str(place["unit"]), "--map", place["register_map"]]
    else:
        where = ["--interface", place["interface"], "--channel", place["channel"], "--nodes", str(place["node_id"])]
    assert main(["scan", *where, "--timeout", "5", "--json", str(out)]) == 0
    (found,) = next(iter(json.loads(out.read_text(encoding="utf-8")).values()))
    return dict(found)
