"""Where a Modbus device is reached: a TCP server or a serial line."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, urlsplit

from drivers.errors import InputError
from drivers.modbus.plan import WireCost


@dataclass(frozen=True)
class TcpEndpoint:
    """A Modbus TCP server; timeout_s: for connecting and for each reply, s."""

    host: str
    port: int = 502
    timeout_s: float = 1.0

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"

    @property
    def cost(self) -> WireCost:
        return WireCost.tcp()


@dataclass(frozen=True)
class RtuEndpoint:
    """A serial line. The standard's line is 19200 8E1 (Modbus over serial line V1.02, 2.5.1)."""

    device: str
    baud: int = 19200
    parity: str = "E"
    stop_bits: int = 1
    timeout_s: float = 0.5

    def __str__(self) -> str:
        return self.device

    @property
    def cost(self) -> WireCost:
        return WireCost.rtu(self.baud)


Endpoint = TcpEndpoint | RtuEndpoint


def parse_endpoint(url: str, *, baud: int = 19200) -> Endpoint:
    """`tcp://host:port` or a serial device, each with `?timeout_s=…`, the device also with `&parity=N&stop_bits=2`.

    Raises InputError naming the part that is wrong.
    """
    parts = urlsplit(url)
    options = {name: values[-1] for name, values in parse_qs(parts.query, keep_blank_values=True).items()}
    timeout = _option(options, "timeout_s", float, "seconds > 0", lambda value: 0 < value < 3600)
    settings: dict[str, Any] = {} if timeout is None else {"timeout_s": timeout}
    endpoint: Endpoint
    if parts.scheme == "tcp":
        try:
            port = parts.port
        except ValueError as error:
            raise InputError(f"address {url!r}: port is not a number 0 to 65535") from error
        if not parts.hostname:
            raise InputError(f"address {url!r} lacks a host, expected tcp://host:port")
        endpoint = TcpEndpoint(parts.hostname, 502 if port is None else port, **settings)
    elif parts.scheme in ("", "rtu") and parts.path:
        parity = _option(options, "parity", str.upper, "N, E or O", lambda value: value in ("N", "E", "O"))
        stop_bits = _option(options, "stop_bits", int, "1 or 2", lambda value: value in (1, 2))
        settings |= {} if parity is None else {"parity": parity}
        settings |= {} if stop_bits is None else {"stop_bits": stop_bits}
        endpoint = RtuEndpoint(parts.path, baud, **settings)
    else:
        raise InputError(f"address {url!r}, expected tcp://host:port or a serial device")
    for name in options:
        raise InputError(f"address {url!r}: unknown option {name}")
    return endpoint


def _option(
    options: dict[str, str], name: str, convert: Callable[[str], Any], expected: str, good: Callable[[Any], bool]
) -> Any:
    if name not in options:
        return None
    text = options.pop(name)
    try:
        value = convert(text)
    except ValueError as error:
        raise InputError(f"address option {name} is {text!r}, expected {expected}") from error
    if not good(value):
        raise InputError(f"address option {name} is {text!r}, expected {expected}")
    return value
