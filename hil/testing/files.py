"""The folder of a simulated axis: axis file, key of the builder, and its passwords in the environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivers.files import replace_file
from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key
from hil.machine.simulated_file import axis_text, instrument_text
from sim_backends.bench import BenchParameters, known_bench

PASSWORDS = {"HIL_PASSWORD": "tables of a simulated axis", "HIL_KEY_PASSWORD": "builder of a simulated axis"}
MACHINE = "typical"
QUICK = Cost(n=1 << 10, r=8, p=1)
SHORT = "dwell_s = 0.1\nreading_s = 0.1\n"
"""At the end of [measurement]."""


def machine_parameters() -> BenchParameters:
    """The machine of the fixtures."""
    return known_bench(MACHINE, 0)


def lay_out(folder: Path, monkeypatch: pytest.MonkeyPatch, drive: dict[str, Any] | None = None, port: str = "") -> Path:
    """Write X.toml, builder.key and builder.pub, and set the passwords; the axis file. drive: keys of [drive], None: of the bench;
    port: of its laser."""
    for name, value in PASSWORDS.items():
        monkeypatch.setenv(name, value)
    key = new_key()
    save_private_key(folder / "builder.key", key, PASSWORDS["HIL_KEY_PASSWORD"], cost=QUICK)
    save_public_key(folder / "builder.pub", key.public_key())
    place = drive or {"backend": "bench", "machine": MACHINE, "seed": 0, "face": "canopen"}
    path = folder / "X.toml"
    replace_file(path, (axis_text(machine_parameters(), place, instrument_text("umd", port)) + SHORT).encode())
    return path
