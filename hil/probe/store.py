"""The store of a probe's run-out: the values in force, replaced completely, and the history of all measurements,
appended.

The values in force are a small JSON file, or, where the machine file asks for it, an entry of a sealed file that only
its builder can change. A refused measurement is in the history only.
"""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from drivers.errors import InputError, StateError
from drivers.files import decode_log, read_bytes, replace_file, sync_directory
from hil.correction.sealed import check, check_seen, open_sealed, remember, require_strong_new, reseal, seal
from hil.probe.runout import FourFeeds, RunOut
from hil.records.files import held, naming, parse_json

FORMAT = "hil-runout-1"
HISTORY_COLUMNS = (
    "time", "mode", "turn", "n_0_mm", "n_90_mm", "n_180_mm", "n_270_mm", "closure_um",
    "x_um", "y_um", "tip_radius_mm", "verdict",
)  # fmt: skip


@dataclass(frozen=True)
class Seal:
    """Password and keys of a sealed store. builder_key: only for writing."""

    password: str
    builder_public: Ed25519PublicKey
    builder_key: Ed25519PrivateKey | None = None


@dataclass(frozen=True)
class RunOutStore:
    """The values and the history of one machine in a directory."""

    directory: Path
    machine: str
    sealing: Seal | None = None

    @property
    def path(self) -> Path:
        """File of the values in force."""
        return self.directory / ("runout.json" if self.sealing is None else "runout.sealed")

    @property
    def by_builder(self) -> bool:
        """Whether it is sealed and its builder's key is given."""
        return self.sealing is not None and self.sealing.builder_key is not None

    @property
    def writable(self) -> bool:
        """Whether values can be put into force: it is not sealed, or its builder's key is given."""
        return self.sealing is None or self.by_builder

    @property
    def history_path(self) -> Path:
        return self.directory / "history.csv"

    @property
    def seen_path(self) -> Path:
        """The note of the sealed file that was used last (`sealed.seen`); values measured with the builder's key replace it."""
        return self.directory / "runout.seen.json"

    def save(self, run_out: RunOut, when: datetime) -> None:
        """Puts values into force. Raises StateError for a sealed store without the builder's key, InputError for a file
        that cannot be written.
        """
        form = {"format": FORMAT, "machine": self.machine, "measured": when.isoformat(), **asdict(run_out)}
        data = (json.dumps(form, indent=1, allow_nan=False) + "\n").encode()
        self.directory.mkdir(parents=True, exist_ok=True)
        with held(self.directory, wait=True):
            if self.sealing is None:
                replace_file(self.path, data)
            else:
                sealed = self._sealed(self.sealing, data)
                replace_file(self.path, sealed)
                remember(self.seen_path, check(sealed, self.sealing.builder_public))

    def _sealed(self, sealing: Seal, data: bytes) -> bytes:
        if sealing.builder_key is None:
            raise StateError(f"{self.path} is locked: changing it needs the builder's private key")
        entries = {f"{self.machine}.runout": data}
        self.check_password()
        if not self.path.exists():
            return seal(entries, sealing.password, sealing.builder_key)
        with naming(self.path):
            return reseal(read_bytes(self.path), entries, sealing.password, sealing.builder_key)

    def check_password(self) -> None:
        """Raises InputError for a new password of a sealed store that is too weak."""
        if self.sealing is not None:
            present = read_bytes(self.path) if self.path.exists() else None
            require_strong_new({f"{self.machine}.runout": self.sealing.password}, present, self.sealing.builder_public)

    def load(self) -> tuple[RunOut, str]:
        """The values in force and when they were measured. Raises InputError or SealedError naming the file."""
        with naming(self.path):
            data = read_bytes(self.path)
            if self.sealing is not None:
                name = f"{self.machine}.runout"
                check_seen(self.seen_path, check(data, self.sealing.builder_public))
                data = open_sealed(data, self.sealing.password, self.sealing.builder_public, names=[name])[name]
            return self._parse(data)

    def _parse(self, data: bytes) -> tuple[RunOut, str]:
        try:
            form = parse_json(data)
        except ValueError as error:
            raise InputError("is not JSON, expected values that `hil probe measure` stored") from error
        if not isinstance(form, dict) or form.get("format") != FORMAT:
            raise InputError(f"is no {FORMAT} file, expected values that `hil probe measure` stored")
        if form.get("machine") != self.machine:
            raise InputError(f"is of machine {form.get('machine')}, expected {self.machine}")
        names = ("x_mm", "y_mm", "tip_radius_mm", "closure_um")
        return RunOut(*(_finite(form, name) for name in names)), str(form.get("measured", ""))

    # -- history -------------------------------------------------------------------------------------------------------
    def append(self, when: datetime, mode: str, turns: tuple[FourFeeds, ...], run_out: RunOut, verdict: str) -> None:
        """Adds a measurement, one line for each turn of the spindle; on return it is on disk. Raises InputError when it
        cannot be written.
        """
        self.directory.mkdir(parents=True, exist_ok=True)
        text = io.StringIO()
        lines = csv.writer(text, lineterminator="\n")
        new = not self.history_path.exists()
        if new:
            lines.writerow(HISTORY_COLUMNS)
        elif not read_bytes(self.history_path).endswith(b"\n"):
            text.write("\n")  # ends the last line, which a power cut left incomplete
        for number, turn in enumerate(turns, start=1):
            feeds = (turn.n_0_mm, turn.n_90_mm, turn.n_180_mm, turn.n_270_mm)
            row = [when.isoformat(), mode, str(number), *(f"{feed:.6f}" for feed in feeds), f"{turn.closure_um:.3f}"]
            row += [
                f"{1000.0 * run_out.x_mm:.3f}",
                f"{1000.0 * run_out.y_mm:.3f}",
                f"{run_out.tip_radius_mm:.6f}",
                verdict,
            ]
            lines.writerow(row)
        try:
            handle = os.open(self.history_path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o666)
            try:
                os.write(handle, text.getvalue().encode())
                os.fsync(handle)
            finally:
                os.close(handle)
            if new:
                sync_directory(self.directory)
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}", path=self.history_path) from error

    def history(self) -> list[dict[str, str]]:
        """The complete lines of the history; empty without a file. Raises InputError for a file that cannot be read."""
        if not self.history_path.exists():
            return []
        text = decode_log(read_bytes(self.history_path))
        whole = text[: text.rfind("\n") + 1]
        rows = csv.DictReader(io.StringIO(whole))
        return [row for row in rows if None not in row and None not in row.values()]  # complete lines only


def _finite(form: Mapping[str, Any], name: str) -> float:
    value = form.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{name} is {value!r}, expected a number")
    return float(value)
