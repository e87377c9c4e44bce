"""Addresses that are no page have STOP and a way back; malformed frames leave a line, no traceback, and the server serves on."""

from __future__ import annotations

import asyncio
import contextlib
import re
import signal
import urllib.error
import urllib.request
from pathlib import Path

import pytest
import websockets
from support import panel
from support.bench_axis import lay_out

pytestmark = pytest.mark.outside
FRAMES: list[list[str | bytes]] = [
    ["garbage"],
    ["42"],
    ["40", "42{"],
    ["40", '42["event"]'],
    ["40", '42["handshake",5]'],
    ["40", '42["event",{"id":1}]'],
    ["40", '42["ack",{}]'],
    ["40", '451-["event",{"_placeholder":true,"num":0}]', b"x"],
    [b"\x00\x01"],
]


def read(address: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(address) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


@pytest.mark.parametrize("language", ["en", "de", "zh"])
def test_what_is_no_page_has_stop_and_a_way_back(language: str, tmp_path: Path) -> None:
    with panel.served(lay_out(tmp_path), "--lang", language) as (address, _):
        for path in ("nothing", "axis/Q/overview", "axis/X/nothing", "a/b/c?d"):
            status, page = read(address + path)
            assert status == 404
            assert 'data-name="stop"' in page
            assert "panel.js" in page
            home = re.search(r'data-name="home" href="/([^"]+)"', page)
            assert home is not None
            assert read(address + home[1])[0] == 200


def test_a_malformed_frame_leaves_no_traceback(tmp_path: Path) -> None:
    with panel.served(lay_out(tmp_path)) as (address, process):
        host = address.split("//")[1].rstrip("/")
        found = re.search(r"client_id[^0-9a-f]+([0-9a-f-]{36})", read(f"{address}axis/X/overview")[1])
        assert found is not None
        where = f"ws://{host}/_nicegui_ws/socket.io/?EIO=4&transport=websocket&client_id={found[1]}"

        async def send() -> None:
            for frames in FRAMES:
                async with websockets.connect(where, origin=f"http://{host}") as socket:  # type: ignore[arg-type]
                    await socket.recv()
                    with contextlib.suppress(websockets.ConnectionClosed):
                        for frame in frames:
                            await socket.send(frame)
                # closed, which the server answers once it has read the frames before

        asyncio.run(send())
        assert read(f"{address}axis/X/overview")[0] == 200
        process.send_signal(signal.SIGINT)
        assert process.stderr is not None
        said = process.stderr.read()
    assert "a malformed frame was dropped" in said
    assert "Traceback" not in said
    assert not list(tmp_path.rglob("*.log"))
