"""Recording a machine while a procedure works on it, and playing the recording as that machine again."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.instruments.replay import Recording
from drivers.machine_recording import MachineRecorder, RecordedDrive, RecordedInstrument
from drivers.machine_replay import MachineReplay, ReplayDrive, ReplayedInstrument
from hil.axis.axis_file import AxisConfig
from hil.machine.wiring import Machine, session_of
from hil.records.files import naming
from sim_backends.clock import SimClock


@contextmanager
def recorded(machine: Machine, path: Path) -> Iterator[None]:
    """Inside the block, drive and instrument of a connected machine are recorded. Raises InputError for a file that is there."""
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
    """The axis of an axis file as it was recorded, in simulated time: nothing real is connected.

    Raises InputError for a file that is no such recording.
    """
    with naming(path):
        replay = MachineReplay(Recording.read(path), SimClock())
    drive = ReplayDrive(axis.name, axis.scaling, axis.limits, replay)
    session = session_of(axis, drive, ReplayedInstrument(replay), None)
    session.zero = drive.before_homing = None  # a recording is no machine that could have another zero
    with session:
        yield Machine(axis, session)
