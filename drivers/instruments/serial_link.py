"""SerialLink: a serial port that is polled: it returns the bytes that have arrived and never waits.

No other module of the instruments uses pyserial; the protocols have no I/O.
"""

from __future__ import annotations

import serial

from drivers.errors import LinkLostError
from drivers.serial_writing import write_now
from drivers.system_errors import told_with_remedy

MAX_READ_BYTES = 65536  # per call, so that a babbling device cannot hold the caller


class SerialLink:
    """Bytes from a port. Opening and reading raise LinkLostError naming the port; closing never raises."""

    def __init__(
        self,
        port: str,
        *,
        baudrate: int = 115200,
        bytesize: int = serial.EIGHTBITS,
        parity: str = serial.PARITY_NONE,
        stopbits: float = serial.STOPBITS_ONE,
    ) -> None:
        self.port = port
        self._baudrate = baudrate
        self._framing = (bytesize, parity, stopbits)
        self._serial: serial.Serial | None = None

    @property
    def is_open(self) -> bool:
        return self._serial is not None

    def open(self) -> None:
        """Open exclusively. Raises LinkLostError."""
        if self._serial is not None:
            return
        try:
            self._serial = serial.Serial(
                self.port, self._baudrate, *self._framing, timeout=0, write_timeout=1.0, exclusive=True
            )
        except (serial.SerialException, OSError, ValueError) as error:
            raise LinkLostError(f"port {self.port} cannot be opened: {told_with_remedy(error, self.port)}") from error

    def close(self) -> None:
        port, self._serial = self._serial, None
        if port is not None:
            try:
                port.close()
            except (serial.SerialException, OSError):
                return  # already gone, which has the same effect

    def read_waiting(self) -> bytes:
        """The bytes that have arrived, possibly none; at most MAX_READ_BYTES. Raises LinkLostError."""
        if self._serial is None:
            raise LinkLostError(f"port {self.port} is not open")
        try:
            data: bytes = self._serial.read(MAX_READ_BYTES)
        except (serial.SerialException, OSError, TypeError) as error:
            # pyserial's POSIX read raises TypeError when the port is closed under it
            raise LinkLostError(f"port {self.port} is gone: {error}") from error
        return data

    def write(self, data: bytes) -> None:
        """Send a request. Raises LinkLostError, also for a port that does not take the few bytes of a request at once."""
        if self._serial is None:
            raise LinkLostError(f"port {self.port} is not open")
        try:
            taken = write_now(self._serial, data)
        except (serial.SerialException, OSError) as error:
            raise LinkLostError(f"port {self.port} is gone: {error}") from error
        if taken != len(data):
            raise LinkLostError(f"port {self.port} accepts no bytes")
