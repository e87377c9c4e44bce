"""The simulated slcan adapter: the protocol's lines as the CAN232 manual has them, and python-can's own host as the judge."""

from __future__ import annotations

import os
import select
from collections.abc import Iterator

import can
import pytest
from can.interfaces.slcan import slcanBus

from sim_backends.slcan import SlcanDevice


@pytest.fixture
def device() -> Iterator[SlcanDevice]:
    device = SlcanDevice()
    yield device
    device.shutdown()


@pytest.fixture
def port(device: SlcanDevice) -> Iterator[int]:
    handle = os.open(device.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    yield handle
    os.close(handle)


def said(port: int, expected: bytes = b"") -> bytes:
    """What the device says; the kernel hands it over in its own time, so as much as is expected is waited for."""
    text = b""
    while select.select([port], [], [], 2.0 if len(text) < len(expected) else 0.01)[0]:
        text += os.read(port, 4096)
    return text


def check_said(port: int, expected: bytes) -> None:
    assert said(port, expected) == expected


def test_commands_are_answered_as_the_manual_says(device: SlcanDevice, port: int) -> None:
    for command, answer in (
        (b"S8\r", b"\r"),
        (b"O\r", b"\r"),
        (b"V\r", b"V1013\r"),
        (b"N\r", b"N1013\r"),
        (b"F\r", b"F00\r"),
        (b"C\r", b"\r"),
        (b"q\r", b"\a"),
        (b"\r", b""),
    ):
        os.write(port, command)
        assert device.recv(0.05) is None
        check_said(port, answer)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (b"t1002AABB\r", can.Message(arbitration_id=0x100, data=b"\xaa\xbb", is_extended_id=False)),
        (b"t0000\r", can.Message(arbitration_id=0, is_extended_id=False)),
        (b"T1FFFFFFF101\r", can.Message(arbitration_id=0x1FFFFFFF, data=b"\x01", is_extended_id=True)),
        (b"r7FF8\r", can.Message(arbitration_id=0x7FF, dlc=8, is_remote_frame=True, is_extended_id=False)),
    ],
)
def test_a_frame_of_the_host_comes_out_on_the_bus(
    device: SlcanDevice, port: int, line: bytes, message: can.Message
) -> None:
    os.write(port, b"O\r" + line)
    received = device.recv(1.0)
    assert received is not None
    assert received.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    check_said(port, b"\rZ\r" if line[:1] in b"TR" else b"\rz\r")


@pytest.mark.parametrize("line", [b"t1002AA\r", b"t1009AABBCCDDEEFF001122\r", b"tXYZ0\r", b"t\r", b"t8001AA\r"])
def test_a_frame_that_is_none_is_refused(device: SlcanDevice, port: int, line: bytes) -> None:
    os.write(port, b"O\r" + line)
    assert device.recv(0.05) is None
    check_said(port, b"\r\a")


def test_nothing_passes_a_closed_channel_and_nothing_is_sent_while_only_listening(
    device: SlcanDevice, port: int
) -> None:
    frame = can.Message(arbitration_id=0x181, data=b"\x01", is_extended_id=False)
    os.write(port, b"t1000\r")
    assert device.recv(0.05) is None
    check_said(port, b"\a")
    device.send(frame)
    check_said(port, b"")
    os.write(port, b"L\rt1000\r")
    assert device.recv(0.05) is None
    check_said(port, b"\r\a")
    device.send(frame)
    check_said(port, b"t181101\r")


def test_a_host_that_does_not_read_loses_whole_lines_and_blocks_nobody(device: SlcanDevice, port: int) -> None:
    os.write(port, b"O\r")
    device.recv(0.05)
    said(port)
    for number in range(8000):
        device.send(can.Message(arbitration_id=0x181, data=number.to_bytes(4, "big"), is_extended_id=False))
    text = b""
    while b"t181" in (data := said(port)):
        text += data
        os.write(port, b"V\r")  # any command lets it go on with what it still holds
        device.recv(0.01)
    lines = [line for line in text.split(b"\r") if line.startswith(b"t")]
    assert [int(line[5:], 16) for line in lines] == list(range(len(lines)))
    assert 100 < len(lines) < 8000


def test_python_cans_host_and_the_device_understand_each_other(device: SlcanDevice) -> None:
    host = slcanBus(device.path, bitrate=1_000_000, sleep_after_open=0.0)
    try:
        out = can.Message(arbitration_id=0x605, data=bytes.fromhex("4041600000000000"), is_extended_id=False)
        host.send(out)
        received = device.recv(2.0)
        assert received is not None
        assert received.equals(out, timestamp_delta=None, check_channel=False, check_direction=False)
        back = can.Message(arbitration_id=0x585, data=bytes.fromhex("4b41600040020000"), is_extended_id=False)
        device.send(back)
        answer = host.recv(2.0)
        assert answer is not None
        assert answer.equals(back, timestamp_delta=None, check_channel=False, check_direction=False)
    finally:
        host.shutdown()
