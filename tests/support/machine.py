"""A machine as processes of its own, each to be killed or frozen alone: a drive over Modbus TCP, and a laser on a terminal."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass
class SimulatedMachine:
    """axis_file: of both; drive, laser: their processes."""

    axis_file: Path
    drive: subprocess.Popen[str]
    laser: subprocess.Popen[str]


@contextmanager
def simulated(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    """`hil sim` with these arguments; its process and what its first line says."""
    command = [sys.executable, "-m", "hil.app", "sim", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process, json.loads(process.stdout.readline())
        finally:
            process.send_signal(signal.SIGCONT)
            process.kill()


@contextmanager
def machine(directory: Path, name: str = "X") -> Iterator[SimulatedMachine]:
    """The machine, with its axis file in the directory."""
    path = directory / f"{name}.toml"
    with (
        simulated("modbus", "--tcp", "127.0.0.1:0", "--laser", "--axis-file", str(path)) as (drive, _),
        simulated("laser", "--still") as (laser, said),
    ):
        text = path.read_text(encoding="utf-8")
        port = json.dumps(said["laser"]["port"])
        path.write_text(re.sub(r'port = "/dev/pts/\d+"', f"port = {port}", text), encoding="utf-8")
        yield SimulatedMachine(path, drive, laser)
