"""A machine with a touch probe as one object for scripts."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from hil.machine.events import Listener, silent
from hil.probe.results import BoreResult, FeatureResult, ProbeCorrectionResult, RunOutResult

if TYPE_CHECKING:  # drivers load slowly
    from hil.probe.machine_file import ProbeMachineConfig
    from hil.probe.runout import CorrectionCode
    from hil.probe.store import RunOutStore


def open_probe(
    path: str | Path, *, password: str | None = None, key_password: str | None = None, on_event: Listener = silent
) -> Probe:
    """The machine of a machine file (`hil probe`). Each of its jobs connects it, and leaves it stopped and disconnected.

    password, key_password, on_event: as for `hil.open`. Raises InputError.
    """
    from hil.probe.machine_file import load_probe_machine  # noqa: PLC0415  (loads slowly)

    return Probe(load_probe_machine(path), password, key_password, on_event)


class Probe:
    """Made by `hil.open_probe`. mode: "latch" or "step", None: that of the machine file."""

    def __init__(self, config: ProbeMachineConfig, reading: str | None, key: str | None, listener: Listener) -> None:
        self.file = config
        self._reading, self._key, self._listener = reading, key, listener

    def __repr__(self) -> str:
        return f"<probe of {self.file.name}>"

    def measure(self, mode: str | None = None) -> RunOutResult:
        """Measure the probe's run-out at the block and put it into force, as `hil probe measure`."""
        from hil.probe import job  # noqa: PLC0415  (drivers load slowly)

        store = self._store(writing=True)
        with job.at_machine(self.file, store, in_bore=False, listener=self._listener) as place:
            found = job.measure(place, mode)
        return RunOutResult(self.file.x, None, self.file, found.measurement, found.refusal, store.history())

    def correct(self, code: str | None = None) -> ProbeCorrectionResult:
        """Move X ("M91"), Y ("M92") or both axes (None) by the run-out in force, as `hil probe correct`."""
        from hil.probe import job  # noqa: PLC0415  (drivers load slowly)

        wanted, store = self._correction(code), self._store()
        known, when = store.load()
        with job.at_machine(self.file, store, listener=self._listener) as place:
            done = job.drive_correction(place, known, wanted)
        return ProbeCorrectionResult(self.file.x, None, self.file, done, when)

    def centre(self, code: str | None = None, mode: str | None = None) -> BoreResult:
        """Find the centre of the bore and move there, corrected, as `hil probe centre`. code: None corrects both axes."""
        from hil.probe import job  # noqa: PLC0415  (drivers load slowly)

        wanted, store = self._correction(code), self._store()
        known, when = store.load()
        with job.at_machine(self.file, store, listener=self._listener) as place:
            found = job.centre(place, known, wanted, mode)
        return BoreResult(self.file.x, None, self.file, found, when)

    def feature(self, name: str, *, spindle_deg: float | None = None, mode: str | None = None) -> FeatureResult:
        """Measure what the machine file describes as "face", "angle", "boss" or "reference". spindle_deg: None: as it stands."""
        from hil.probe import job  # noqa: PLC0415  (drivers load slowly)

        self.file.require_feature(name)
        store = self._store()
        known, when = store.load()
        with job.at_machine(self.file, store, feature=name, listener=self._listener) as place:
            found = job.measure_other(place, known, name, mode, spindle_deg=spindle_deg)
        return FeatureResult(self.file.x, None, self.file, found, when)

    def _correction(self, code: str | None) -> CorrectionCode:
        from hil.probe.runout import CorrectionCode  # noqa: PLC0415

        return CorrectionCode.M93 if code is None else self.file.codes.correction(code)

    def _store(self, *, writing: bool = False) -> RunOutStore:
        from hil.probe.job import opened_store  # noqa: PLC0415  (drivers load slowly)
        from hil.ui.terminal.options import KEY, READING  # noqa: PLC0415
        from hil.ui.terminal.passwords import password  # noqa: PLC0415

        def reading() -> str:
            return self._reading or password(None, READING, "reading password", os.environ)

        def key() -> str:
            return self._key or password(None, KEY, "builder key's password", os.environ)

        return opened_store(self.file, reading, key if writing else None)
