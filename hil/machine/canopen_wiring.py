"""CANopen drives from axis files."""

from __future__ import annotations

from contextlib import ExitStack

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.canopen.eds import load_eds
from drivers.canopen.table_map import load_table_map
from drivers.clock import Clock
from hil.axis.axis_file import DriveAxis
from hil.machine.links import Links, guarded


def canopen_drive(
    axis: DriveAxis, clock: Clock, bus: tuple[str, str], stack: ExitStack, *, links: Links | None = None
) -> CanOpenDrive:
    """The CANopen drive of an axis file, not opened. bus: python-can's interface and channel."""
    config, homing, (interface, channel) = axis.drive, axis.drive.homing, bus
    shared = Links() if links is None else links
    if bus not in shared.can and shared.network is not None:
        from drivers.canopen.beside import SharedBus  # noqa: PLC0415  (the canopen package is slow to import)

        shared.can[bus] = stack.enter_context(CanLink(SharedBus(shared.network), clock, config.bitrate))
    if bus not in shared.can:
        shared.can[bus] = stack.enter_context(
            CanLink.open(clock, interface=interface, channel=channel, bitrate=config.bitrate)
        )
    settings = CanOpenSettings(
        sdo_timeout_s=config.sdo_timeout_s,
        sample_timeout_s=config.sample_timeout_s,
        heartbeat_s=config.heartbeat_s,
        guard_s=config.guard_s,
        velocity_unit=config.velocity_unit,
        acceleration_unit=config.acceleration_unit,
        modes=config.modes,
        axis=config.axis,
        homing=HomingSettings(homing.method, homing.speed_switch_mm_s, homing.speed_zero_mm_s, homing.home_position_mm),
    )
    drive = CanOpenDrive(
        axis.name,
        axis.scaling,
        axis.limits,
        clock,
        link=shared.can[bus],
        node_id=config.node_id,
        settings=settings,
        eds=None if config.eds is None else load_eds(config.eds, config.node_id),
        table=load_table_map(config.correction_table) if config.correction_table else None,
    )
    if shared.network is not None:
        from drivers.canopen.beside import Beside  # noqa: PLC0415  (as above)

        stack.enter_context(Beside(drive, shared.network))
    return guarded(axis, drive)
