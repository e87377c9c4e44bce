"""SDO frames byte by byte, for the master's transfers and the simulated drive's server apart (CiA-301, 7.2.4.3)."""

from pathlib import Path

import pytest

from drivers.canopen.sdo_transfer import (
    Conversation,
    Transfer,
    block_download,
    block_upload,
    crc16,
    download,
    upload,
)
from drivers.errors import AbortError, ProtocolError
from sim_backends.canopen_dictionary import Dictionary, load_items
from sim_backends.canopen_drive import EDS
from sim_backends.canopen_sdo_server import SdoServer

# request by the client, answers by the server, in the order of the wire
UPLOAD_STATUSWORD = [("40 41 60 00 00 00 00 00", ["4b 41 60 00 37 02 00 00"])]
UPLOAD_POSITION = [("40 64 60 00 00 00 00 00", ["43 64 60 00 f0 ff ff ff"])]
UPLOAD_MODE = [("40 61 60 00 00 00 00 00", ["4f 61 60 00 08 00 00 00"])]
DOWNLOAD_CONTROLWORD = [("2b 40 60 00 0f 00 00 00", ["60 40 60 00 00 00 00 00"])]
DOWNLOAD_TARGET = [("23 7a 60 00 00 e1 f5 05", ["60 7a 60 00 00 00 00 00"])]
DOWNLOAD_MODE = [("2f 60 60 00 01 00 00 00", ["60 60 60 00 00 00 00 00"])]
UPLOAD_NAME = [  # 10 bytes "Feed axis!"
    ("40 08 10 00 00 00 00 00", ["41 08 10 00 0a 00 00 00"]),
    ("60 00 00 00 00 00 00 00", ["00 46 65 65 64 20 61 78"]),
    ("70 00 00 00 00 00 00 00", ["19 69 73 21 00 00 00 00"]),
]
DOWNLOAD_COMMENT = [
    ("21 01 21 00 0a 00 00 00", ["60 01 21 00 00 00 00 00"]),
    ("00 46 65 65 64 20 61 78", ["20 00 00 00 00 00 00 00"]),
    ("19 69 73 21 00 00 00 00", ["30 00 00 00 00 00 00 00"]),
]
BLOCK_DOWNLOAD = [  # 10 bytes and their CRC
    ("c6 00 21 00 0a 00 00 00", ["a4 00 21 00 7f 00 00 00"]),
    ("01 46 65 65 64 20 61 78", []),
    ("82 69 73 21 00 00 00 00", ["a2 02 7f 00 00 00 00 00"]),
    ("d1 ?? ?? 00 00 00 00 00", ["a1 00 00 00 00 00 00 00"]),
]
BLOCK_UPLOAD = [
    ("a4 00 21 00 7f 00 00 00", ["c6 00 21 00 0a 00 00 00"]),
    ("a3 00 00 00 00 00 00 00", ["01 46 65 65 64 20 61 78", "82 69 73 21 00 00 00 00"]),
    ("a2 02 7f 00 00 00 00 00", ["d1 ?? ?? 00 00 00 00 00"]),
    ("a1 00 00 00 00 00 00 00", []),
]
TEXT = b"Feed axis!"


def reference_crc(data: bytes) -> int:
    """CCITT by shifting single bits, as CiA-301 draws it."""
    register = 0
    for byte in data:
        for place in range(7, -1, -1):
            top = register >> 15 & 1
            register = register << 1 & 0xFFFF
            if top ^ (byte >> place & 1):
                register ^= 0x1021
    return register


def _bytes(text: str) -> bytes:
    crc = reference_crc(TEXT).to_bytes(2, "little")
    return bytes.fromhex(text.replace("?? ??", crc.hex(" ")))


Exchange = list[tuple[str, list[str]]]


def _drive_client(transfer: Transfer[object], talk: Conversation, exchange: Exchange) -> object:
    """Feed the answers to the transfer; every frame it sends must be the one written down."""
    expected = [_bytes(request) for request, _ in exchange]
    answers = [_bytes(answer) for _, group in exchange for answer in group]
    sent: list[bytes] = []
    result: object = None
    try:
        sent += next(transfer)
        for answer in answers:
            sent += transfer.send(answer)
    except StopIteration as stop:
        result = stop.value
    sent += talk.closing_frames
    assert [frame.hex(" ") for frame in sent] == [frame.hex(" ") for frame in expected]
    return result


@pytest.mark.parametrize(
    ("exchange", "index", "value"),
    [
        (UPLOAD_STATUSWORD, 0x6041, b"\x37\x02"),
        (UPLOAD_POSITION, 0x6064, b"\xf0\xff\xff\xff"),
        (UPLOAD_MODE, 0x6061, b"\x08"),
        (UPLOAD_NAME, 0x1008, TEXT),
    ],
)
def test_the_client_uploads(exchange: Exchange, index: int, value: bytes) -> None:
    talk = Conversation(index, 0)
    assert _drive_client(upload(talk), talk, exchange) == value


@pytest.mark.parametrize(
    ("exchange", "index", "value"),
    [
        (DOWNLOAD_CONTROLWORD, 0x6040, b"\x0f\x00"),
        (DOWNLOAD_TARGET, 0x607A, b"\x00\xe1\xf5\x05"),
        (DOWNLOAD_MODE, 0x6060, b"\x01"),
        (DOWNLOAD_COMMENT, 0x2101, TEXT),
    ],
)
def test_the_client_downloads(exchange: Exchange, index: int, value: bytes) -> None:
    talk = Conversation(index, 0)
    _drive_client(download(talk, value), talk, exchange)


def test_the_client_downloads_a_block() -> None:
    talk = Conversation(0x2100, 0)
    exchange = [BLOCK_DOWNLOAD[0], BLOCK_DOWNLOAD[1], BLOCK_DOWNLOAD[2], BLOCK_DOWNLOAD[3]]
    _drive_client(block_download(talk, TEXT), talk, exchange)


def test_the_client_uploads_a_block() -> None:
    talk = Conversation(0x2100, 0)
    assert _drive_client(block_upload(talk), talk, BLOCK_UPLOAD) == TEXT


def _server(values: dict[int, bytes]) -> SdoServer:
    dictionary = Dictionary(load_items(Path(EDS), 5))
    for index, data in values.items():
        dictionary.set_raw((index, 0), data)
    return SdoServer(dictionary)


@pytest.mark.parametrize(
    ("exchange", "values"),
    [
        (UPLOAD_STATUSWORD, {0x6041: b"\x37\x02"}),
        (UPLOAD_POSITION, {0x6064: b"\xf0\xff\xff\xff"}),
        (UPLOAD_MODE, {0x6061: b"\x08"}),
        (UPLOAD_NAME, {0x1008: TEXT}),
        (DOWNLOAD_CONTROLWORD, {}),
        (DOWNLOAD_TARGET, {}),
        (DOWNLOAD_MODE, {}),
        (DOWNLOAD_COMMENT, {}),
        (BLOCK_DOWNLOAD, {}),
        (BLOCK_UPLOAD, {0x2100: TEXT}),
    ],
)
def test_the_server_answers(exchange: Exchange, values: dict[int, bytes]) -> None:
    server = _server(values)
    for request, answers in exchange:
        got = [frame.hex(" ") for frame in server.handle(_bytes(request))]
        assert got == [_bytes(answer).hex(" ") for answer in answers]


@pytest.mark.parametrize(
    ("request_frame", "abort"),
    [
        ("40 00 55 00 00 00 00 00", "80 00 55 00 00 00 02 06"),  # no such object
        ("40 18 10 09 00 00 00 00", "80 18 10 09 11 00 09 06"),  # no such sub-index
        ("2b 41 60 00 00 00 00 00", "80 41 60 00 02 00 01 06"),  # read only
        ("2f 40 60 00 0f 00 00 00", "80 40 60 00 13 00 07 06"),  # too short
        ("23 40 60 00 0f 00 00 00", "80 40 60 00 12 00 07 06"),  # too long
        ("2b 5a 60 00 09 00 00 00", "80 5a 60 00 31 00 09 06"),  # 605Ah is 8 at most
        ("2b 5a 60 00 ff ff 00 00", "80 5a 60 00 32 00 09 06"),  # 605Ah is 0 at least
        ("60 00 00 00 00 00 00 00", "80 00 00 00 01 00 04 05"),  # a segment of nothing
    ],
)
def test_the_server_refuses(request_frame: str, abort: str) -> None:
    answer = _server({}).handle(bytes.fromhex(request_frame))
    assert [frame.hex(" ") for frame in answer] == [abort]


def test_an_abort_names_object_and_reason() -> None:
    transfer = upload(Conversation(0x607D, 3))
    next(transfer)
    with pytest.raises(AbortError, match=r"607Dh:03 refused: sub-index does not exist \(0x06090011\)") as caught:
        transfer.send(bytes.fromhex("80 7d 60 03 11 00 09 06"))
    assert caught.value.code == 0x06090011


def test_an_answer_to_something_else_is_no_answer() -> None:
    talk = Conversation(0x607A, 0)
    transfer = download(talk, b"\x01\x00\x00\x00")
    next(transfer)
    assert transfer.send(bytes.fromhex("60 81 60 00 00 00 00 00")) == ()  # a late confirmation of 6081h
    assert transfer.send(bytes.fromhex("80 81 60 00 30 00 09 06")) == ()  # or its late abort
    with pytest.raises(AbortError):
        transfer.send(bytes.fromhex("80 7a 60 00 30 00 09 06"))


def test_a_segment_with_the_wrong_toggle_ends_the_transfer() -> None:
    talk = Conversation(0x1008, 0)
    transfer = upload(talk)
    next(transfer)
    transfer.send(bytes.fromhex("41 08 10 00 0a 00 00 00"))
    with pytest.raises(ProtocolError, match="toggle"):
        transfer.send(bytes.fromhex("10 46 65 65 64 20 61 78"))
    assert [frame.hex(" ") for frame in talk.closing_frames] == ["80 08 10 00 00 00 03 05"]


def test_a_block_with_a_wrong_crc_ends_the_transfer() -> None:
    talk = Conversation(0x2100, 0)
    transfer = block_upload(talk)
    next(transfer)
    for answer in ("c6 00 21 00 0a 00 00 00", "01 46 65 65 64 20 61 78", "82 69 73 21 00 00 00 00"):
        transfer.send(bytes.fromhex(answer))
    with pytest.raises(ProtocolError, match="CRC"):
        transfer.send(bytes.fromhex("d1 00 00 00 00 00 00 00"))
    assert [frame.hex(" ") for frame in talk.closing_frames] == ["80 00 21 00 04 00 04 05"]


def test_the_crc_is_that_of_the_check_string() -> None:
    """The published check value of CRC-16/XMODEM."""
    assert crc16(b"123456789") == 0x31C3
    assert reference_crc(b"123456789") == 0x31C3
