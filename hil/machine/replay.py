"""Recording a machine during a procedure, and replaying the recording as that machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.instruments.replay import Recording
from drivers.machine_recording import MachineRecorder, RecordedDrive, RecordedInstrument
from drivers.machine_replay import MachineReplay, ReplayDrive, ReplayedInstrument
from hil.axis.axis_file import AxisConfig
from hil.machine.machine import Machine, session_of
from hil.records.files import naming
from sim_backends.clock import SimClock


@contextmanager
def recorded(machine: Machine, path: Path) -> Iterator[None]:
    """Record drive and instrument of a connected machine inside the block. Raises InputError where the file exists."""
    watched = machine.session.axis
    drive, instrument = watched.drive, machine.session.instrument
    config = machine.axis.instrument
    with MachineRecorder(path, machine.clock, tuple(config.place_temps), tuple(config.beside or ())) as recorder:
        watched.drive = RecordedDrive(drive, recorder)
        watched.instrument = RecordedInstrument(instrument, recorder)
        watched.drive.sample()
        try:
            yield
        finally:
            watched.drive, watched.instrument = drive, instrument


@contextmanager
def replayed(axis: AxisConfig, path: Path) -> Iterator[Machine]:
    """The axis of an axis file from a recording, in simulated time. No hardware is connected.

    Raises InputError for a file that is no recording of this axis file.
    """
    with naming(path):
        replay = MachineReplay(Recording.read(path), SimClock())
    drive = ReplayDrive(axis.name, axis.scaling, axis.limits, replay)
    session = session_of(axis, drive, ReplayedInstrument(replay), None)
    session.zero = drive.before_homing = None  # the zero of a recording cannot change
    session.made_with = None
    with session:
        yield Machine(axis, session)
