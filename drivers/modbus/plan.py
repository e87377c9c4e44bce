"""Planning of requests: reads grouped for the shortest time on the wire, with that time.

Pure functions. A request costs a frame each way, two silent intervals and the drive's processing time, so reading a few registers too
many is often cheaper than a second request; how many depends on the wire, see `WireCost`. A value of several registers
is never split over two requests: its halves would be of different moments.

Wire time of Modbus RTU: 11 bits per character, silent interval t3.5 = 3.5 characters up to 19200 baud and 1.75 ms above
(Modbus over serial line V1.02, 2.5.1.1): T = (request + reply) · 11/baud + 2 · t3.5 + T_drive.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

from drivers.errors import InputError

MAX_READ_REGISTERS = 125  # Modbus application protocol V1.1b3, 6.3 and 6.4
MAX_READ_BITS = 2000  # 6.1 and 6.2
MAX_WRITE_REGISTERS = 123  # 6.12
MAX_WRITE_BITS = 1968  # 6.11
_BITS_PER_CHARACTER = 11


class AddressSpace(Enum):
    """The four address spaces of Modbus."""

    COIL = "coil"
    DISCRETE = "discrete"
    INPUT = "input"
    HOLDING = "holding"

    @property
    def is_bits(self) -> bool:
        """Whether it holds bits (coils, discrete inputs), not registers."""
        return self in (AddressSpace.COIL, AddressSpace.DISCRETE)

    @property
    def is_writable(self) -> bool:
        """Whether it can be written (coils, holding registers)."""
        return self in (AddressSpace.COIL, AddressSpace.HOLDING)


@dataclass(frozen=True, order=True)
class Span:
    """`count` neighbouring registers (or bits) from the 0-based PDU address `start`. Raises InputError beyond 65535."""

    start: int
    count: int

    def __post_init__(self) -> None:
        if self.start < 0 or self.count < 1 or self.end > 0x10000:
            raise InputError(f"registers {self.start} to {self.end - 1}, expected to lie within 0 to 65535")

    @property
    def end(self) -> int:
        """The first address behind it."""
        return self.start + self.count

    def covers(self, other: Span) -> bool:
        """Whether the other span lies within this one."""
        return self.start <= other.start and other.end <= self.end


@dataclass(frozen=True)
class WireCost:
    """The time that requests take, s: `fixed_s` per request, `per_byte_s` per byte of either direction (headers are added here).

    header_bytes: bytes of request and reply together that are not PDU.
    """

    fixed_s: float
    per_byte_s: float
    header_bytes: int

    @classmethod
    def rtu(cls, baud: int, drive_s: float = 0.001) -> WireCost:
        """A serial line of `baud` bit/s; drive_s: processing time of the drive, s."""
        return cls(2 * silent_interval_s(baud) + drive_s, _BITS_PER_CHARACTER / baud, 2 * 3)  # unit id and CRC each way

    @classmethod
    def tcp(cls, round_trip_s: float = 0.001) -> WireCost:
        """Ethernet of 100 Mbit/s; 20+20+7+18 bytes of IP, TCP, MBAP and Ethernet each way. Times in s."""
        return cls(round_trip_s, 8 / 100e6, 2 * 65)

    def exchange_s(self, request_pdu: int, reply_pdu: int) -> float:
        """Seconds for one request and its reply, given the bytes of their PDUs."""
        return self.fixed_s + (self.header_bytes + request_pdu + reply_pdu) * self.per_byte_s

    def read_s(self, table: AddressSpace, count: int) -> float:
        """Seconds to read `count` registers or bits in one request."""
        return self.exchange_s(5, 2 + _data_bytes(table, count))

    def write_s(self, table: AddressSpace, count: int) -> float:
        """Seconds to write `count` registers or bits in one request (function 5 or 6 for one, 15 or 16 for more)."""
        if count == 1:
            return self.exchange_s(5, 5)
        return self.exchange_s(6 + _data_bytes(table, count), 5)


def silent_interval_s(baud: int) -> float:
    """The pause that ends an RTU frame, s: 3.5 characters, a fixed 1.75 ms above 19200 baud. Raises InputError for baud <= 0."""
    if baud <= 0:
        raise InputError(f"baud is {baud}, expected > 0")
    return 3.5 * _BITS_PER_CHARACTER / baud if baud <= 19200 else 0.00175


@dataclass(frozen=True)
class ReadRequest:
    """One request on the wire."""

    table: AddressSpace
    span: Span


@dataclass(frozen=True)
class ReadPlan:
    """Requests that together read everything wanted, and the predicted time on the wire, s."""

    requests: tuple[ReadRequest, ...]
    wire_s: float


def plan_reads(
    wanted: Iterable[tuple[AddressSpace, Span]],
    cost: WireCost,
    *,
    gaps_readable: bool = True,
    apart: bool = False,
    avoid: Iterable[tuple[AddressSpace, Span]] = (),
    max_registers: int = MAX_READ_REGISTERS,
) -> ReadPlan:
    """Group reads so that the wire is busy for the shortest time; ties go to fewer requests.

    apart: one request for each value, of a drive whose addresses are numbers of objects.
    gaps_readable: False for drives that refuse a request touching an address they do not have.
    avoid: registers that must not be read along either (write-only registers, registers that act when read).
    max_registers: the drive's own limit for one request, at most 125 (bits: 2000 regardless).
    Raises InputError when one value alone is longer than a request may be.
    """
    if not 1 <= max_registers <= MAX_READ_REGISTERS:
        raise InputError(f"max_registers is {max_registers}, expected 1 to {MAX_READ_REGISTERS}")
    if apart:
        requests = [ReadRequest(table, span) for table, span in dict.fromkeys(wanted)]
        return ReadPlan(tuple(requests), sum(cost.read_s(each.table, each.span.count) for each in requests))
    per_table: dict[AddressSpace, set[Span]] = {}
    for table, span in wanted:
        per_table.setdefault(table, set()).add(span)
    requests = []
    avoided = list(avoid)
    for table in sorted(per_table, key=lambda table: table.value):
        limit = MAX_READ_BITS if table.is_bits else max_registers
        blocks = _merge_overlapping(sorted(per_table[table]), limit)
        shunned = [span for other, span in avoided if other is table]
        joins = [
            (gaps_readable or first.end == second.start)
            and not any(first.end < span.end and span.start < second.start for span in shunned)
            for first, second in itertools.pairwise(blocks)
        ]
        requests.extend(ReadRequest(table, span) for span in _group(table, blocks, cost, joins, limit))
    return ReadPlan(tuple(requests), sum(cost.read_s(each.table, each.span.count) for each in requests))


def _merge_overlapping(spans: Sequence[Span], limit: int) -> list[Span]:
    """Values that share registers are one indivisible block."""
    blocks: list[Span] = []
    for span in spans:
        if blocks and span.start < blocks[-1].end:
            last = blocks.pop()
            span = Span(last.start, max(last.end, span.end) - last.start)  # noqa: PLW2901
        if span.count > limit:
            raise InputError(
                f"{span.count} registers from address {span.start} cannot be read at once, limit is {limit}"
            )
        blocks.append(span)
    return blocks


def _group(
    table: AddressSpace, blocks: Sequence[Span], cost: WireCost, joins: Sequence[bool], limit: int
) -> list[Span]:
    """The cheapest way to split the ordered blocks into runs: best[i] covers the first i blocks.

    joins[i]: block i and the next may be read together.
    """
    best: list[tuple[float, int]] = [(0.0, 0)]
    cut: list[int] = [0]
    for end in range(1, len(blocks) + 1):
        candidates: list[tuple[float, int, int]] = []
        for start in range(end - 1, -1, -1):
            if start < end - 1 and not joins[start]:
                break
            count = blocks[end - 1].end - blocks[start].start
            if count > limit:
                break
            seconds, requests = best[start]
            candidates.append((seconds + cost.read_s(table, count), requests + 1, start))
        seconds, requests, start = min(candidates)
        best.append((seconds, requests))
        cut.append(start)
    runs: list[Span] = []
    end = len(blocks)
    while end > 0:
        start = cut[end]
        runs.append(Span(blocks[start].start, blocks[end - 1].end - blocks[start].start))
        end = start
    return runs[::-1]


def group_writes(
    writes: Sequence[tuple[AddressSpace, Span]], *, max_registers: int = MAX_WRITE_REGISTERS
) -> list[list[int]]:
    """Indices of `writes`, in their order, grouped where one follows the other without a gap in the same table.

    Never reordered (a start bit must come after its target) and never bridging a gap (other registers would be written).
    """
    groups: list[list[int]] = []
    for index, (table, span) in enumerate(writes):
        if groups:
            last_table, last = writes[groups[-1][-1]]
            first = writes[groups[-1][0]][1]
            limit = MAX_WRITE_BITS if table.is_bits else max_registers
            if table is last_table and span.start == last.end and span.end - first.start <= limit:
                groups[-1].append(index)
                continue
        groups.append([index])
    return groups


def _data_bytes(table: AddressSpace, count: int) -> int:
    return (count + 7) // 8 if table.is_bits else 2 * count
