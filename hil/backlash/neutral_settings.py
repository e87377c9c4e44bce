"""A drive's backlash compensation switched off during a measurement, and restored afterwards in every case.

Two settings: the amount, and (where the drive has one) the acceleration switch. Their values are noted in a file before
the first change, so that they can be restored even after the process was killed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from drivers.errors import BridgeError, SafetyError
from drivers.files import replace_file
from hil.desk.job import Tell
from hil.records.files import read_note


class Setting(Protocol):
    """One number kept by the drive or, where the drive has none, in a file. Both methods raise what access to a
    parameter raises.

    resolution: the smallest difference between two values that it can hold.
    """

    @property
    def name(self) -> str: ...

    @property
    def resolution(self) -> float: ...

    def read(self) -> float: ...

    def write(self, value: float) -> None:
        """Writes and reads back; raises ProtocolError when another value is read."""


class NotRestoredError(SafetyError):
    """A setting could not be restored; the message names it and its earlier value."""


@dataclass(frozen=True)
class BacklashSettings:
    """The amount, of which 1 is `amount_um` µm, the acceleration switch, and the file in which their values are
    noted. scale: see `BacklashConfig`.
    """

    amount: Setting
    amount_um: float
    acceleration: Setting | None
    note: Path
    scale: float = 1.0

    def settings(self) -> tuple[Setting, ...]:
        """Both, in the order in which they are changed."""
        return (self.amount,) if self.acceleration is None else (self.amount, self.acceleration)

    def amount_of(self, lost_motion_um: float) -> float:
        """The amount for a lost motion measured by torque, µm, in the drive's unit, rounded to its resolution."""
        return self.amount_for(lost_motion_um * self.scale)

    def amount_for(self, backlash_um: float) -> float:
        """The amount that stands for so many µm."""
        step = self.amount.resolution
        return round(round(backlash_um / self.amount_um / step) * step, 9)


@dataclass(frozen=True)
class SettingsBefore:
    """The values before the measurement, by name; from_note: read from the note of an earlier, interrupted
    measurement.
    """

    values: dict[str, float]
    from_note: bool


def read_before(settings: BacklashSettings) -> SettingsBefore:
    """Reads the present values, or those that an interrupted measurement noted. Changes nothing. Raises InputError for
    a damaged note.
    """
    noted = _noted(settings.note)
    values = {setting.name: setting.read() for setting in settings.settings()}
    return SettingsBefore(values if noted is None else {**values, **noted}, noted is not None)


@contextmanager
def neutral(settings: BacklashSettings, tell: Tell) -> Iterator[SettingsBefore]:
    """Both settings 0 inside; on leaving they have their earlier values. tell: receives what could not be restored.

    Raises NotRestoredError when nothing else failed; else the first error is passed on.
    """
    found = read_before(settings)
    replace_file(settings.note, (json.dumps(found.values, indent=2) + "\n").encode())
    try:
        for setting in settings.settings():
            setting.write(0)
        yield found
    except BaseException:
        _put_back(settings, found, tell)
        raise
    failed = _put_back(settings, found, tell)
    if failed:
        raise NotRestoredError(failed)


def restore(settings: BacklashSettings) -> SettingsBefore | None:
    """Restores what an interrupted measurement left changed; None when there was none. Raises NotRestoredError."""
    if _noted(settings.note) is None:
        return None
    found = read_before(settings)
    failed = _put_back(settings, found, lambda _text: None)
    if failed:
        raise NotRestoredError(failed)
    return found


def _put_back(settings: BacklashSettings, found: SettingsBefore, tell: Tell) -> str:
    """Restores the switch first, then the amount; an interrupt in between is raised afterwards. Returns the failures in
    one sentence.
    """
    failures: list[str] = []
    interrupt: KeyboardInterrupt | None = None
    for setting in reversed(settings.settings()):
        for _ in range(2):
            try:
                setting.write(found.values[setting.name])
                break
            except KeyboardInterrupt as error:
                interrupt = error
            except BridgeError as error:
                failures.append(f"{setting.name} was {found.values[setting.name]:g} ({error})")
                break
    if failures:
        text = f"not put back: {'; '.join(failures)}; kept in {settings.note}, `--restore` puts it back"
        tell(text)
        return text
    settings.note.unlink(missing_ok=True)
    if interrupt is not None:
        raise interrupt
    return ""


def _noted(path: Path) -> dict[str, float] | None:
    def read(form: Any) -> dict[str, float]:
        if not all(isinstance(value, int | float) for value in form.values()):
            raise ValueError("types")
        return {str(name): value for name, value in form.items()}

    return read_note(path, read, "holds no values noted before a measurement")
