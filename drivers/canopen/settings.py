"""Settings of a CANopen drive: times, supervision, and those of CiA 402."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.cia402.settings import Cia402Settings


@dataclass(frozen=True)
class CanOpenSettings(Cia402Settings):
    """Times in seconds. heartbeat_s: the period requested of the drive, None leaves it and its supervision unchanged.

    guard_s: the drive shall stop (6007h: quick stop) when it has not received our own heartbeat, sent as node `master_id`, for so
    long: 1016h is set up for it; where that fails, the drive's notes say so. None: 1016h is not written, and an axis continues
    its move when this process ends or the cable breaks. No node of the bus may have the id `master_id`.

    axis: of a node with several axes; indices + 800h for each further one.
    """

    sdo_timeout_s: float = 0.5
    sample_timeout_s: float = 0.1
    heartbeat_s: float | None = 0.2
    heartbeat_grace: float = 2.5  # times the period
    guard_s: float | None = None
    master_id: int = 127
    axis: int = 1
