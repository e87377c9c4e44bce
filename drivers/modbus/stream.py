"""Set-points to a Modbus drive whose register map states a cyclic one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from drivers.drive import DriveSample
from drivers.errors import InputError
from drivers.modbus.drive_map import StreamMap
from drivers.paced_stream import PacedStream
from drivers.set_points import SetPointSettings

if TYPE_CHECKING:
    from drivers.modbus.drive import ModbusDrive


class ModbusStream(PacedStream):
    """Each cycle writes one set-point and reads one sample. Entering raises InputError for a period that map or wire cannot keep."""

    def __init__(self, drive: ModbusDrive, stream: StreamMap, settings: SetPointSettings) -> None:
        super().__init__(drive, settings)
        self._modbus = drive
        self._stream = stream

    def _begin(self) -> DriveSample:
        drive, period_s = self._modbus, self.settings.period_s
        target = drive.registers[self._stream.target]
        wire_s = drive.sample_wire_s + drive.link.cost.write_s(target.table, target.span.count)
        for least_s, whose in ((self._stream.least_period_s, "the drive by its register map"), (wire_s, "the wire")):
            if period_s < least_s:
                raise InputError(
                    f"drive {drive.name}: stream period is {1e3 * period_s:g} ms, {whose} needs {1e3 * least_s:.3g} ms"
                )
        return drive.begin_stream()

    def _send(self, position_load_mm: float) -> None:
        self._modbus.send_set_point(position_load_mm)

    def _end(self) -> None:
        self._modbus.end_stream()
