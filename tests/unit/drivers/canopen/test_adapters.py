"""CAN adapters: a piece that is no frame costs that piece, and an adapter that cannot be opened says what to do about it."""

from __future__ import annotations

import errno
import os
import select
import socket
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import can
import pytest

from drivers.canopen.adapters import open_adapter, place_of
from drivers.canopen.bus import MOST_FAILED, CanLink
from drivers.clock import WallClock
from drivers.errors import LinkLostError

Put = Callable[[bytes], Any]


@contextmanager
def slcan() -> Iterator[tuple[CanLink, Put]]:
    """On pyserial's loop: what is put into it comes back as if the adapter had sent it."""
    options = {"sleep_after_open": 0, "timeout": 0}
    with CanLink.open(WallClock(), interface="slcan", channel="loop://", options=options) as link:
        port = link.bus.serialPortOrig  # type: ignore[attr-defined]
        port.reset_input_buffer()
        yield link, port.write


@contextmanager
def serial() -> Iterator[tuple[CanLink, Put]]:
    with CanLink.open(WallClock(), interface="serial", channel="loop://", options={"timeout": 0}) as link:
        yield link, link.bus._ser.write  # type: ignore[attr-defined]


@contextmanager
def socketcand() -> Iterator[tuple[CanLink, Put]]:
    """A server that shakes hands as socketcand does."""
    connections: list[socket.socket] = []

    def shake_hands() -> None:
        connection, _ = server.accept()
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connections.append(connection)
        connection.sendall(b"< hi >")
        for asked in (b"< open can0 >", b"< rawmode >"):
            assert connection.recv(64) == asked
            connection.sendall(b"< ok >")

    with socket.create_server(("127.0.0.1", 0)) as server:
        greeter = threading.Thread(target=shake_hands)
        greeter.start()
        options = {"host": "127.0.0.1", "port": server.getsockname()[1]}
        with CanLink.open(WallClock(), interface="socketcand", channel="can0", options=options) as link:
            greeter.join()
            with connections[0]:
                yield link, connections[0].sendall


GOOD = {
    slcan: b"t28121122\r",
    serial: b"\xaa\0\0\0\0\x02\x81\x02\0\0\x11\x22\xbb",  # time, length, identifier, data, end
    socketcand: b"< frame 281 1.0 1122 >",
}


@pytest.mark.parametrize(
    ("adapter", "damaged"),
    [
        (slcan, b"t28180102030405060t2\r"),  # two lines that ran into each other
        (slcan, b"t281801020304050607\xff8\r"),  # a byte above 127, which python-can keeps and fails at again
        (slcan, b"t2\r"),
        (slcan, b"t281X11223344\r"),
        (slcan, b"t2818112233\r"),  # cut short: a frame of 3 bytes that says 8
        (slcan, b"tFFF21122\r"),
        (slcan, b"d28121122\r"),  # the rest of a line cut short that looks like a CAN FD frame
        (serial, b"\xaa\0\0\0\0\x02\x81\x02\0\0\x11\x22\x00"),
        (serial, b"\xaa\0\0\0\0\x0f"),
        (serial, b"\xaa\0\0"),
        (socketcand, b"< frame 2z1 1.0 1122 >"),  # kept, and tried again with every later frame
        (socketcand, b"< frame 281 >"),
        (socketcand, b"< frame 281 1.0 11\xff2 >"),
    ],
)
def test_a_piece_that_is_no_frame_is_left_out_and_the_next_frame_comes(
    adapter: Callable[[], Any], damaged: bytes
) -> None:
    with adapter() as (link, put):
        seen: list[bytes] = []
        link.watch(lambda _time_ns, cob_id, data: seen.append(data if cob_id == 0x281 else b"wrong"))
        for times in (1, 2, 3):
            put(damaged)
            link.wait(lambda: False, 0.02)
            put(GOOD[adapter])
            assert link.wait(lambda times=times: len(seen) == times, 5.0)  # type: ignore[misc]
        assert seen == [b"\x11\x22"] * 3
        link.send(0x305, b"\x02\x00")


class Failing(can.BusABC):
    """Every read raises this error; what is sent is taken."""

    def __init__(self, error: Exception) -> None:
        super().__init__(channel=None)
        self.error, self.reads = error, 0

    def recv(self, timeout: float | None = None) -> can.Message | None:
        self.reads += 1
        raise self.error

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Take it."""


@pytest.mark.parametrize("error", [can.CanOperationError("adapter removed"), ValueError("-1"), IndexError("range")])
def test_an_adapter_whose_every_read_fails_is_gone_and_still_sent_to(error: Exception) -> None:
    bus = Failing(error)
    with CanLink(bus, WallClock()) as link:
        with pytest.raises(LinkLostError, match=rf"CAN Failing: is gone: {MOST_FAILED} reads in a row failed: {error}"):
            link.wait(lambda: False, 1.0)
        assert bus.reads == MOST_FAILED
        link.send(0x305, b"\x02\x00")


@pytest.mark.parametrize("wrapped", [False, True])
def test_an_adapter_that_the_system_says_is_gone_is_gone_at_once(wrapped: bool) -> None:
    error: Exception = OSError(errno.ENETDOWN, "Network is down")
    if wrapped:
        error, error.__cause__ = can.CanOperationError("Error receiving: Network is down"), error
    bus = Failing(error)
    with (
        CanLink(bus, WallClock()) as link,
        pytest.raises(LinkLostError, match=r"Network is down; sudo ip link set .* up"),
    ):
        link.wait(lambda: False, 1.0)
    assert bus.reads == 1


@contextmanager
def slcan_on_a_terminal() -> Iterator[tuple[CanLink, int]]:
    """A link, and the adapter's end of its port, which nothing reads."""
    master, slave = os.openpty()
    try:
        tty.setraw(slave)
        options = {"sleep_after_open": 0, "timeout": 0}
        with CanLink.open(WallClock(), interface="slcan", channel=os.ttyname(slave), options=options) as link:
            yield link, master
    finally:
        os.close(master)
        os.close(slave)


def test_a_frame_that_the_port_took_is_sent_however_late_this_process_was() -> None:
    with slcan_on_a_terminal() as (link, master):
        for number in range(20):
            link.send(0x305, bytes([number]), timeout_s=1e-9)  # over before the port is asked
        sent = b"".join(b"t3051%02X\r" % number for number in range(20))
        seen = b""
        while not seen.endswith(sent):
            seen += os.read(master, 4096)


def test_a_frame_that_the_port_does_not_take_in_time_is_not_sent() -> None:
    with slcan_on_a_terminal() as (link, _):
        while select.select([], [link.bus], [], 0.2)[1]:  # the kernel makes room until both ends are full
            with suppress(BlockingIOError):
                while True:
                    os.write(link.bus.fileno(), b"\0")
        with pytest.raises(LinkLostError, match="frame 305h cannot be sent: Could not write"):
            link.send(0x305, b"", timeout_s=0.01)


def test_a_bus_is_named_by_its_channel_never_as_unknown() -> None:
    assert place_of(Failing(ValueError())) == "Failing"
    with slcan() as (link, _):
        assert link.bus.channel_info == "unknown"
        link.bus.serialPortOrig.close()  # type: ignore[attr-defined]
        with pytest.raises(LinkLostError, match=r"^CAN slcan loop://: is gone"):
            link.poll()
        with pytest.raises(LinkLostError, match=r"^CAN slcan loop://: frame 305h cannot be sent"):
            link.send(0x305, b"")


def raising(error: Exception) -> Callable[..., can.BusABC]:
    def bus(*_: object, **__: object) -> can.BusABC:
        raise error

    return bus


@pytest.mark.parametrize(
    ("interface", "error", "remedy"),
    [
        ("kvaser", NameError("name 'canGetNumberOfChannels' is not defined"), "install Kvaser's driver"),
        ("ixxat", can.CanInterfaceNotImplementedError("cannot import name 'HRESULT'"), "install HMS' IXXAT VCI driver"),
        ("pcan", OSError("pcanbasic library not found."), "install PEAK's driver"),
        ("neovi", ImportError("Please install python-ics"), 'install the Python package "python-ics"'),
        ("vector", AttributeError("module 'ctypes' has no attribute 'windll'"), "install Vector's XL driver library"),
        ("socketcan", OSError(errno.EAFNOSUPPORT, "Address family not supported"), "sudo modprobe can-raw"),
        ("socketcan", OSError(errno.ENODEV, "No such device"), "ip link lists them"),
        ("slcan", PermissionError(errno.EACCES, "Permission denied"), "sudo usermod -aG GROUP"),
        ("seeedstudio", FileNotFoundError(errno.ENOENT, "No such file"), "is the adapter plugged in"),
        ("socketcand", ConnectionRefusedError(errno.ECONNREFUSED, "Connection refused"), "is its server running"),
        ("kvaser", ValueError("channel must be an integer"), "cannot be opened: channel must be an integer"),
    ],
)
def test_an_adapter_that_cannot_be_opened_says_what_to_install_or_to_do(
    interface: str, error: Exception, remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(can, "Bus", raising(error))
    with pytest.raises(LinkLostError) as told:
        open_adapter(interface, "can0", {})
    text = str(told.value)
    assert text.startswith(f"CAN {interface} can0 cannot be opened: ")
    assert remedy in text
    assert "\n" not in text
