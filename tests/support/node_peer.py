"""An independent CANopen device in a process of its own, spoken to in JSON lines (see tests/interop/node_canopen/peer.js)."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

PEER = Path(__file__).parents[1] / "interop" / "node_canopen" / "peer.js"
START_LIMIT_S = 90.0
LIMIT_S = 60.0

Message = dict[str, Any]


class PeerError(Exception):
    """The foreign stack refused; `code` is its SDO abort code where it gave one."""

    def __init__(self, message: str, code: int | None) -> None:
        super().__init__(message)
        self.code = code


class NodePeer:
    """Starts the peer on a CAN interface; `modules` is the directory that holds node_modules."""

    def __init__(self, modules: Path, interface: str) -> None:
        try:
            self._process = subprocess.Popen(
                ["node", str(PEER), interface],
                env={**os.environ, "NODE_PATH": str(modules / "node_modules")},
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                bufsize=1,
            )
        except OSError as error:
            raise PeerError(f"node cannot be started: {error}", None) from error
        self._number = 0
        self._incoming: queue.Queue[Message | None] = queue.Queue()
        self.events: list[Message] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.wait_event(lambda event: event["event"] == "ready", START_LIMIT_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _read(self) -> None:
        for line in self._process.stdout or ():
            self._incoming.put(json.loads(line))
        self._incoming.put(None)

    def _next(self, end: float) -> Message:
        try:
            message = self._incoming.get(timeout=max(0.0, end - time.monotonic()))
        except queue.Empty:
            raise PeerError(f"the peer said nothing more; last events: {self.events[-5:]}", None) from None
        if message is None:
            raise PeerError(f"the peer is gone with status {self._process.poll()}", None)
        return message

    def ask(self, do: str, **arguments: Any) -> Message:
        """Send a command and wait for the answer. Raises PeerError when the peer refuses or cannot."""
        number = self.post(do, **arguments)
        end = time.monotonic() + LIMIT_S
        while True:
            message = self._next(end)
            if message.get("id") == number:
                return self._checked(message)
            self.events.append(message)

    def post(self, do: str, **arguments: Any) -> int:
        """Send a command without waiting; the answer's number for `answer`. Raises PeerError."""
        if self._process.stdin is None:
            raise PeerError("the peer has no stdin", None)
        self._number += 1
        self._process.stdin.write(json.dumps({"id": self._number, "do": do, **arguments}) + "\n")
        return self._number

    @staticmethod
    def _checked(message: Message) -> Message:
        if "error" in message:
            raise PeerError(message["error"], message.get("code"))
        return message

    def wait_event(self, wanted: Callable[[Message], bool], limit_s: float = LIMIT_S) -> Message:
        """The first matching event of those not yet taken. Raises PeerError when none comes within limit_s seconds."""
        end = time.monotonic() + limit_s
        seen = 0
        while True:
            while seen < len(self.events):
                if wanted(self.events[seen]):
                    return self.events.pop(seen)
                seen += 1
            self.events.append(self._next(end))

    def upload(self, server: int, index: int, subindex: int = 0, *, block: bool = False) -> bytes:
        """Read an object of an SDO server on the bus."""
        answer = self.ask("upload", server=server, index=index, subindex=subindex, block=block)
        return bytes.fromhex(answer["data"])

    def download(self, server: int, index: int, subindex: int, data: bytes, *, block: bool = False) -> None:
        """Write an object of an SDO server on the bus."""
        self.ask("download", server=server, index=index, subindex=subindex, data=data.hex(), block=block)
