"""A drive's backlash compensation taken out of force for as long as something is measured, and put back whatever happens.

Two settings: the amount, and (where the drive has one) the switch of the acceleration that hides it. What they were is noted in a file
before the first is touched, so that even a process that was killed can be made good.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from drivers.errors import BridgeError, InputError, SafetyError
from hil.records.files import read_text, replace_file

Tell = Callable[[str], None]


class Setting(Protocol):
    """One number that the drive (or, for want of one, a file) keeps. Both raise what access to a parameter raises.

    resolution: the smallest difference between two values that it can hold.
    """

    @property
    def name(self) -> str: ...

    @property
    def resolution(self) -> float: ...

    def read(self) -> float: ...

    def write(self, value: float) -> None:
        """Write and read back; raises ProtocolError when another value stands there."""


class NotRestoredError(SafetyError):
    """A setting could not be put back; the message names it and what it was."""


@dataclass(frozen=True)
class BacklashSettings:
    """The amount, of which 1 is `amount_um` µm, the switch, and where their values are noted meanwhile."""

    amount: Setting
    amount_um: float
    acceleration: Setting | None
    note: Path

    def settings(self) -> tuple[Setting, ...]:
        """In the order in which they are changed."""
        return (self.amount,) if self.acceleration is None else (self.amount, self.acceleration)

    def amount_of(self, lost_motion_um: float) -> float:
        """The amount as the drive keeps it, to what it can hold."""
        step = self.amount.resolution
        return round(round(lost_motion_um / self.amount_um / step) * step, 9)


@dataclass(frozen=True)
class Found:
    """What stood there before, by name; from_note: a measurement before this one did not get to put it back."""

    values: dict[str, float]
    from_note: bool


def look(settings: BacklashSettings) -> Found:
    """Read the present values, or what an earlier measurement noted and never put back. Changes nothing."""
    noted = _noted(settings.note)
    values = {setting.name: setting.read() for setting in settings.settings()}
    return Found(values if noted is None else {**values, **noted}, noted is not None)


@contextmanager
def neutral(settings: BacklashSettings, tell: Tell) -> Iterator[Found]:
    """Both 0 inside; on leaving both are as they were. tell: hears what could not be put back.

    Raises NotRestoredError when nothing else went wrong; else the error under way goes on.
    """
    found = look(settings)
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


def restore(settings: BacklashSettings) -> Found | None:
    """Put back what an earlier measurement left changed; None when none did. Raises NotRestoredError."""
    if _noted(settings.note) is None:
        return None
    found = look(settings)
    failed = _put_back(settings, found, lambda _text: None)
    if failed:
        raise NotRestoredError(failed)
    return found


def _put_back(settings: BacklashSettings, found: Found, tell: Tell) -> str:
    """The switch first, then the amount; an interrupt in between is heard once all is done. What failed, in one sentence."""
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
    if not path.exists():
        return None
    try:
        values = json.loads(read_text(path))
    except ValueError as error:
        raise InputError("is not JSON, expected the values noted before a measurement", path=path) from error
    if not isinstance(values, dict) or not all(isinstance(value, int | float) for value in values.values()):
        raise InputError("holds no values noted before a measurement", path=path)
    return {str(name): value for name, value in values.items()}
