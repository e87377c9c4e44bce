"""Fleets of campaigns on disk, written apart from the program: many axes, measured again and again, some of which age."""

from __future__ import annotations

import hashlib
import json
import os
import time
from datetime import datetime
from pathlib import Path

import numpy as np

HEADER = "run,direction,target_mm,command_mm,measured_mm,time_s,temp_screw_c,air_temp_c"


def rows(
    rng: np.random.Generator,
    backlash_um: float,
    *,
    targets: int = 25,
    runs: int = 5,
    noise_um: float = 0.4,
    temp_c: float = 21.0,
) -> str:
    """The lines of a pass: targets up and down in each run, corrected by a table for a backlash of 10 µm."""
    at = np.linspace(20.0, 480.0, targets)
    target = np.tile(np.concatenate([at, at[::-1]]), runs)
    direction = np.tile(np.repeat([1, -1], targets), runs)
    run = np.repeat(np.arange(1, runs + 1), 2 * targets)
    pitch_um = 4.0 * np.sin(target / 90.0)
    command = target + (-pitch_um + 5.0 * direction) / 1000.0
    screw_c = temp_c + 0.3 * np.arange(len(run)) / len(run)
    own_um = pitch_um - 0.5 * backlash_um * direction + 11.0 * target / 1000.0 * (screw_c - 20.0)
    measured = command + (own_um + rng.normal(0.0, noise_um, len(run))) / 1000.0
    table = zip(run, direction, target, command, measured, 6.0 * np.arange(len(run)), screw_c, strict=True)
    return "".join(f"{r},{d:+d},{t:.4f},{c:.6f},{m:.6f},{s:.1f},{k:.2f},20.5\n" for r, d, t, c, m, s, k in table)


def write_campaign(
    directory: Path,
    axis: str,
    begun: datetime,
    lines: str,
    *,
    kind: str = "verify",
    name: str = "verify",
    header: str = HEADER,
) -> Path:
    """A closed campaign of one pass, as the program leaves it, without its chain."""
    directory.mkdir(parents=True)
    (directory / "campaign.json").write_text(json.dumps({"axis": axis, "kind": kind}))
    data = f"# begun {begun.isoformat(timespec='seconds')}\n{header}\n{lines}".encode()
    (directory / f"{name}.csv").write_bytes(data)
    (directory / "SHA256SUMS").write_text(f"{hashlib.sha256(data).hexdigest()}  {name}.csv\n")
    return directory


def worked(number: int) -> tuple[int, int]:
    """A task of some milliseconds for executors: the square, and the process that computed it."""
    time.sleep(0.02)
    return number**2, os.getpid()


def killed_once(marks: str) -> str:
    """A task whose first process is killed, as for lack of memory; `marks` is the file that remembers it."""
    if not Path(marks).exists():
        Path(marks).write_text(str(os.getpid()))
        os.kill(os.getpid(), 9)
    return "done"


def killed_always(_number: int) -> None:
    """A task that no process survives."""
    os.kill(os.getpid(), 9)
