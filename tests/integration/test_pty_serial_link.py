"""The serial link over a real terminal: takes what is there, waits for nothing, says when it is gone."""

import os
import threading
import tty
from collections.abc import Iterator
from contextlib import suppress

import pytest

from drivers.errors import LinkLostError
from drivers.instruments.serial_link import MAX_READ_BYTES, SerialLink

pytestmark = pytest.mark.outside


@pytest.fixture
def ends() -> Iterator[tuple[int, str]]:
    """(the device's end, the path of the port)."""
    device, port = os.openpty()
    tty.setraw(port)
    yield device, os.ttyname(port)
    os.close(port)
    os.close(device)


def arrived(link: SerialLink, count: int) -> bytes:
    data = b""
    for _ in range(1_000_000):
        data += link.read_waiting()
        if len(data) >= count:
            return data
    raise AssertionError(f"only {data!r} arrived")


def test_both_ways(ends: tuple[int, str]) -> None:
    device, path = ends
    link = SerialLink(path)
    link.open()
    link.open()  # twice is once
    assert link.is_open
    assert link.read_waiting() == b""
    os.write(device, b"\x00\xff12\r\n")
    assert arrived(link, 6) == b"\x00\xff12\r\n"
    link.write(b"\x02\r")
    assert os.read(device, 10) == b"\x02\r"
    link.close()
    link.close()
    assert not link.is_open


def test_a_closed_link_says_so(ends: tuple[int, str]) -> None:
    link = SerialLink(ends[1])
    with pytest.raises(LinkLostError, match="not open"):
        link.read_waiting()
    with pytest.raises(LinkLostError, match="not open"):
        link.write(b"x")


def test_a_port_is_opened_by_one_only(ends: tuple[int, str]) -> None:
    first, second = SerialLink(ends[1]), SerialLink(ends[1])
    first.open()
    with pytest.raises(LinkLostError, match="cannot be opened"):
        second.open()
    first.close()
    second.open()
    second.close()


def test_a_port_that_takes_no_bytes_is_gone_at_once(ends: tuple[int, str]) -> None:
    """pyserial's own write would spin until its time-out, in which nobody hears the operator."""
    link = SerialLink(ends[1])
    link.open()

    def fill() -> None:
        for _ in range(10_000):
            link.write(bytes(100))

    with pytest.raises(LinkLostError, match=r"accepts no bytes|is gone"):
        fill()
    link.close()


def test_a_babbling_device_holds_nobody(ends: tuple[int, str]) -> None:
    device, path = ends
    link = SerialLink(path)
    link.open()
    os.set_blocking(device, False)
    over = threading.Event()

    def babble() -> None:
        while not over.is_set():
            with suppress(BlockingIOError):
                os.write(device, b"\x55" * 4096)

    babbler = threading.Thread(target=babble)
    babbler.start()
    try:
        assert all(len(link.read_waiting()) <= MAX_READ_BYTES for _ in range(200))
    finally:
        over.set()
        babbler.join()
        link.close()
