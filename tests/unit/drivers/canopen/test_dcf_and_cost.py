"""DCF and concise DCF against a foreign reader and the standard's bytes; the predicted cost against the simulated bus's own count."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import canopen
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.can_bus_model import frame_bits as bus_bits

from drivers.canopen.dcf import pack_concise, render_dcf, unpack_concise
from drivers.canopen.eds import load_eds
from drivers.canopen.sdo_transfer import Conversation, download, upload
from drivers.canopen.wire_time import frame_bits, transfer
from drivers.errors import InputError
from sim_backends.canopen_dictionary import Dictionary, load_items
from sim_backends.canopen_drive import EDS
from sim_backends.canopen_sdo_server import SdoServer


@given(st.integers(0, 0x7FF), st.binary(max_size=8))
def test_no_frame_is_longer_than_predicted(cob_id: int, data: bytes) -> None:
    """By the bus's own count; a frame of 8 bytes has 111 to 135 bits, one without 47 to 55."""
    assert bus_bits(cob_id, data) <= frame_bits(len(data))
    assert (frame_bits(8), frame_bits(6), frame_bits(0)) == (135, 115, 55)


@given(st.binary(min_size=1, max_size=40))
def test_predicted_frames_are_those_that_a_client_and_a_server_exchange(data: bytes) -> None:
    server = SdoServer(Dictionary(load_items(EDS, 5)))
    for steps in (download(Conversation(0x2101, 0), data), upload(Conversation(0x2101, 0))):
        requests, answers = 0, []
        frames: Sequence[bytes] = next(steps)
        with suppress(StopIteration):
            while True:
                requests += len(frames)
                answers += [answer for frame in frames for answer in server.handle(frame)]
                frames = steps.send(answers[-1])
        cost = transfer(len(data), 1_000_000)
        assert (cost.frames, cost.answers) == (requests + len(answers), len(answers))


def test_a_dcf_is_read_by_the_canopen_package_and_by_us(tmp_path: Path) -> None:
    values = [
        ((0x2210, 1), (4321).to_bytes(4, "little")),
        ((0x605A, 0), (-2).to_bytes(2, "little", signed=True)),
        ((0x2101, 0), b"spare drive"),
    ]
    path = tmp_path / "x.dcf"
    path.write_text(render_dcf(EDS, values, 9), encoding="utf-8")
    theirs = canopen.import_od(str(path))
    assert (theirs[0x2210][1].value, theirs[0x605A].value, theirs[0x2101].value) == (4321, -2, "spare drive")
    assert theirs.node_id == 9
    ours, eds = load_eds(path), load_eds(EDS, 9)
    assert ours.node_id == 9
    assert {key: found.value for key, found in ours.entries.items() if found.value is not None} == {
        (0x2210, 1): 4321,
        (0x605A, 0): -2,
        (0x2101, 0): "spare drive",
    }
    for key, found in eds.entries.items():
        again = ours.entries[key]
        assert (again.entry, again.access, again.low, again.high) == (found.entry, found.access, found.low, found.high)
    with pytest.raises(InputError, match="has no object 5000h:00"):
        render_dcf(EDS, [((0x5000, 0), b"\0")], 9)


def test_concise_dcf_as_the_standard_has_it() -> None:
    """CiA-302: number of entries, then index, sub-index, size and data of each, little endian."""
    objects = [((0x6081, 0), b"\x10\x27\0\0"), ((0x1017, 0), b"\xe8\x03"), ((0x2101, 0), b"")]
    block = bytes.fromhex("03000000 8160 00 04000000 10270000 1710 00 02000000 e803 0121 00 00000000")
    assert pack_concise(objects) == block
    assert unpack_concise(block) == objects
    for cut in range(len(block)):
        with pytest.raises(InputError):
            unpack_concise(block[:cut])
    with pytest.raises(InputError, match="has 1 bytes behind its 3 entries"):
        unpack_concise(block + b"\0")
