"""Back to what the maker shipped: 1011h and a restart. Nothing of it can be put back but from a backup."""

from __future__ import annotations

from collections.abc import Sequence

from drivers.errors import StateError
from drivers.raw_parameters import RawParameters, Steps
from hil.parameters.audit import Ask, restart_drive
from hil.parameters.preflight import objection_to_state
from hil.parameters.transaction import ended_in
from hil.parameters.works import one_at_a_time, run_together


def load_defaults(drives: Sequence[RawParameters], ask: Ask) -> list[str]:
    """Factory defaults in force, the drives started anew; of each drive what went wrong, "" where nothing did."""
    ask = one_at_a_time(ask)
    errors = run_together(drives, lambda drive: drive, lambda drive: _load(drive, ask))
    return ["" if error is None else ended_in(error) for error in errors]


def _load(drive: RawParameters, ask: Ask) -> Steps[None]:
    objection = objection_to_state((yield from drive.state()))
    if objection is not None:
        raise StateError(f"drive {drive.name}: {objection.why}")
    yield from drive.load_defaults()
    yield from restart_drive(drive, ask)
