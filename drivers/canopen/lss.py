"""LSS master (CiA-305): finds nodes that have no node id yet, and assigns one.

A node is selected by its identity (1018h); fast scan finds an unknown identity bit by bit.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.canopen.bus import CanLink
from drivers.errors import InputError, NoAnswerError, ProtocolError

MASTER, SLAVE = 0x7E5, 0x7E4
SWITCH_GLOBAL, CONFIGURE_NODE, CONFIGURE_BIT_RATE, ACTIVATE_BIT_RATE, STORE = 0x04, 0x11, 0x13, 0x15, 0x17
SELECT = (0x40, 0x41, 0x42, 0x43)
SELECTED, IDENTIFY_UNCONFIGURED, UNCONFIGURED, IDENTIFIED, FAST_SCAN = 0x44, 0x4C, 0x50, 0x4F, 0x51
INQUIRE = (0x5A, 0x5B, 0x5C, 0x5D)
INQUIRE_NODE = 0x5E
WAITING, CONFIGURATION = 0x00, 0x01
CONFIRM_ALL = 0x80  # bit check of the first fast scan message
BIT_RATES = (1_000_000, 800_000, 500_000, 250_000, 125_000, 0, 50_000, 20_000, 10_000)  # standard table; 5 is reserved
UNCONFIGURED_ID = 0xFF
ERRORS = {1: "out of range or not supported", 2: "access to the storage failed"}


@dataclass(frozen=True)
class LssAddress:
    """A node's identity, the four numbers of 1018h."""

    vendor_id: int
    product_code: int
    revision: int
    serial: int

    @property
    def parts(self) -> tuple[int, int, int, int]:
        """The four numbers in the order in which LSS sends them."""
        return self.vendor_id, self.product_code, self.revision, self.serial

    def __str__(self) -> str:
        return " ".join(f"{part:08X}h" for part in self.parts)


class LssMaster:
    """LSS on one link. timeout_s: longest time for an answer, s; fast scan waits that long for each bit, as several may answer."""

    def __init__(self, link: CanLink, *, timeout_s: float = 0.05) -> None:
        self._link = link
        self._timeout_s = timeout_s
        self._answers: list[bytes] = []

    def find_unconfigured(self) -> LssAddress | None:
        """The identity of one node without a node id, None when there is none; it is left in configuration state.

        With several such nodes the one with the smallest numbers answers through to the end; assign it an id and ask again.
        Raises ProtocolError when the nodes' answers fit no single identity.
        """
        self._send(SWITCH_GLOBAL, bytes((WAITING,)))
        if not self._scan(0, CONFIRM_ALL, 0, 0):
            return None
        parts = []
        for part in range(4):
            number = 0
            for bit in range(31, -1, -1):
                if not self._scan(number, bit, part, part):
                    number |= 1 << bit
            if not self._scan(number, 0, part, (part + 1) % 4):
                raise ProtocolError(f"LSS fast scan: no node confirms part {part + 1} of the identity, {number:08X}h")
            parts.append(number)
        return LssAddress(*parts)

    def any_unconfigured(self) -> bool:
        """Whether there is any node without a node id. Raises LinkLostError."""
        return self._ask(IDENTIFY_UNCONFIGURED, b"", UNCONFIGURED) is not None

    def select(self, address: LssAddress) -> None:
        """Put the node with this identity, and no other, into configuration state. Raises NoAnswerError when there is none."""
        self.release()
        for command, part in zip(SELECT[:3], address.parts[:3], strict=True):
            self._send(command, struct.pack("<I", part))
        if self._ask(SELECT[3], struct.pack("<I", address.serial), SELECTED) is None:
            raise NoAnswerError(f"LSS: no node with the identity {address} answers")

    def release(self) -> None:
        """Put all nodes into waiting state; one that was given its first node id starts now."""
        self._send(SWITCH_GLOBAL, bytes((WAITING,)))

    def identity(self) -> LssAddress:
        """Identity of the node in configuration state. Raises NoAnswerError."""
        parts = []
        for command in INQUIRE:
            answer = self._ask(command, b"", command)
            if answer is None:
                raise NoAnswerError("LSS: no node in configuration state answers")
            parts.append(struct.unpack_from("<I", answer, 1)[0])
        return LssAddress(*parts)

    def node_id(self) -> int | None:
        """Id of the node in configuration state, None while it has none. Raises NoAnswerError."""
        answer = self._ask(INQUIRE_NODE, b"", INQUIRE_NODE)
        if answer is None:
            raise NoAnswerError("LSS: no node in configuration state answers")
        return None if answer[1] == UNCONFIGURED_ID else answer[1]

    def set_node_id(self, node_id: int) -> None:
        """Set the id (1 to 127) of the node in configuration state; in force after `release` (first id) or its next start.

        Raises InputError, NoAnswerError, ProtocolError."""
        if not 1 <= node_id <= 127:
            raise InputError(f"node id is {node_id}, expected 1 to 127")
        self._order(CONFIGURE_NODE, bytes((node_id,)), f"node id {node_id}")

    def set_bit_rate(self, bitrate: int) -> None:
        """Set the bit rate, bit/s, of the node in configuration state; in force after its next start.

        Raises InputError for one that is not in the standard table, NoAnswerError, ProtocolError."""
        if bitrate not in BIT_RATES or not bitrate:
            raise InputError(f"bit rate is {bitrate}, expected one of {sorted(rate for rate in BIT_RATES if rate)}")
        self._order(CONFIGURE_BIT_RATE, bytes((0, BIT_RATES.index(bitrate))), f"bit rate {bitrate}")

    def store(self) -> None:
        """Store node id and bit rate without power. Raises NoAnswerError, ProtocolError."""
        self._order(STORE, b"", "storing")

    def assign(self, address: LssAddress, node_id: int, *, store: bool = True) -> None:
        """Select a node by its identity, assign a node id, store it if wanted, and let it start. Raises as the single steps."""
        self.select(address)
        self.set_node_id(node_id)
        if store:
            self.store()
        self.release()

    # -- frames ----------------------------------------------------------------------------------------------------------
    def _order(self, command: int, data: bytes, what: str) -> None:
        answer = self._ask(command, data, command)
        if answer is None:
            raise NoAnswerError(f"LSS: {what} was not answered; no node is in configuration state")
        if answer[1]:
            raise ProtocolError(f"LSS: {what} was refused: {ERRORS.get(answer[1], f'error {answer[1]}')}")

    def _scan(self, number: int, bit: int, part: int, next_part: int) -> bool:
        question = struct.pack("<IBBB", number, bit, part, next_part)
        return self._ask(FAST_SCAN, question, IDENTIFIED, wait_for_all=True) is not None

    def _send(self, command: int, data: bytes) -> None:
        self._link.send(MASTER, (bytes((command,)) + data).ljust(8, b"\0"))

    def _ask(self, command: int, data: bytes, answered_by: int, *, wait_for_all: bool = False) -> bytes | None:
        """The answer with the right command, None when none comes in time.

        wait_for_all: wait the whole time, so that a second node's answer is not taken for one to the next question.
        """
        self._link.poll()
        self._answers.clear()

        def hear(_time_ns: int, answer: bytes) -> None:
            if len(answer) == 8 and answer[0] == answered_by:
                self._answers.append(answer)

        self._link.subscribe(SLAVE, hear)
        try:
            self._send(command, data)
            self._link.wait(lambda: bool(self._answers) and not wait_for_all, self._timeout_s)
        finally:
            self._link.unsubscribe(SLAVE, hear)
        return self._answers[0] if self._answers else None
