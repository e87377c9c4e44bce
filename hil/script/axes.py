"""Several axes of one machine, for scripts: one clock, each watches the others, an error stops all."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.errors import CapabilityError
from hil.axis.axis_file import AxisConfig, load_drive_axis
from hil.machine.events import Listener, silent
from hil.script.given import Passwords
from hil.script.open_axis import OpenAxis


@contextmanager
def open_axes(
    *paths: str | Path, password: str | None = None, key_password: str | None = None, on_event: Listener = silent
) -> Iterator[tuple[OpenAxis, ...]]:
    """The axes of several axis files, each with an instrument, connected together for a `with` block; arguments as for `hil.open`.

    `parameters` and straightness need an axis alone and raise CapabilityError.
    """
    files = [load_drive_axis(path) for path in paths]
    measured = [one for one in files if isinstance(one, AxisConfig)]
    if len(measured) < len(files):
        name = next(one.name for one in files if not isinstance(one, AxisConfig))
        raise CapabilityError(f"axis {name} has no instrument: several axes are opened with one each")
    from hil.desk.axis_thread import Connection  # noqa: PLC0415  (drivers load slowly)
    from hil.machine.axes_wiring import connected_axes  # noqa: PLC0415

    with connected_axes(measured) as machines:
        passwords = Passwords(password, key_password)
        connections = [Connection(one.session.drive, one.session) for one in machines]
        axes = [OpenAxis(file, passwords, on_event, on) for file, on in zip(measured, connections, strict=True)]
        try:
            yield tuple(axes)
        finally:
            for axis in axes:
                axis.forget()
