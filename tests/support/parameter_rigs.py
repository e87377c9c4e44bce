"""Simulated CANopen drives with many manufacturer parameters, and sets for them."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from support.can_bench import CanBench

from drivers.canopen.bus import FASTEST, CanLink
from drivers.canopen.eds import EdsFile, load_eds
from drivers.canopen.known_objects import address_of
from drivers.canopen.node import Node
from drivers.canopen.raw_parameters import CanOpenRawParameters
from drivers.canopen.side_by_side import CanLine
from hil.parameters.journal import Journal
from hil.parameters.set_file import ParameterSet, SetEntry
from sim_backends.canopen_drive import EDS
from sim_backends.canopen_faults import CanFault
from sim_backends.canopen_store import Flash
from sim_backends.clock import SimClock
from sim_backends.faults import CanFaultKind

TYPES = ((0x0007, 4, 0), (0x0006, 2, 0), (0x0005, 1, 0), (0x0004, 4, -5), (0x0003, 2, -5), (0x0002, 1, -5))
"""CiA code, bytes and default of the manufacturer parameters, in turn."""
FIRST = 0x3000


def maker_eds(folder: Path, count: int) -> Path:
    """The simulated drive's EDS with `count` manufacturer parameters added: records of 100 from 3000h on, of six types in turn."""
    text = EDS.read_text(encoding="utf-8")
    sections = []
    for record in range(-(-count // 100)):
        members = min(100, count - 100 * record)
        index = FIRST + record
        sections.append(
            f"[{index:04X}]\nParameterName=Group {record}\nObjectType=0x9\nSubNumber={members + 1}\n"
            f"[{index:04X}sub0]\nParameterName=Highest sub-index supported\nObjectType=0x7\nDataType=0x0005\n"
            f"AccessType=const\nDefaultValue={members}\nPDOMapping=0"
        )
        for member in range(1, members + 1):
            code, _, default = TYPES[(member - 1) % len(TYPES)]
            sections.append(
                f"[{index:04X}sub{member:X}]\nParameterName=Parameter {100 * record + member}\nObjectType=0x7\n"
                f"DataType=0x{code:04X}\nAccessType=rw\nDefaultValue={default}\nPDOMapping=0"
            )
    path = folder / f"maker-{count}.eds"
    path.write_text(text.rstrip() + "\n" + "\n".join(sections) + "\n", encoding="utf-8")
    return path


def maker_keys(count: int) -> list[tuple[int, int]]:
    return [(FIRST + number // 100, number % 100 + 1) for number in range(count)]


def maker_set(count: int, *, seed: int = 1) -> ParameterSet:
    """New values for all of them, each different from its default."""
    entries = []
    for number, key in enumerate(maker_keys(count)):
        size = TYPES[number % 100 % len(TYPES)][1]
        value = 1 + (seed * 7919 + number * 104_729) % ((1 << (8 * size - 1)) - 2)
        entries.append(SetEntry(address_of(key), value, value, name=f"Parameter {number + 1}"))
    return ParameterSet("new", None, tuple(entries))


class ParameterRig:
    """Drives on one simulated wire, accessed by their parameters. only: the node to which the faults apply."""

    def __init__(
        self,
        eds: Path,
        folder: Path,
        *,
        nodes: Sequence[int] = (5,),
        bitrate: int | None = 1_000_000,
        turnaround_s: float = 0.0,
        faults: Sequence[CanFault] = (),
        only: int | None = None,
        flash: Flash | None = None,
        timeout_s: float = 0.05,
        file: EdsFile | None = None,
        clock: SimClock | None = None,
    ) -> None:
        slow = (CanFault(CanFaultKind.SDO_LATE, size=turnaround_s),) if turnaround_s else ()
        self.bench = CanBench(
            nodes,
            bitrate,
            {node: (*(faults if only in (None, node) else ()), *slow) for node in nodes},
            flash=flash,
            eds=eds,
            clock=SimClock() if clock is None else clock,
        )
        self.stack = ExitStack()
        self.link = self.stack.enter_context(CanLink(self.bench.port(), self.bench.clock, bitrate or FASTEST))
        self.line = CanLine(self.link)
        self.nodes = [
            Node(f"X{node}", self.link, node, file if file is not None else load_eds(eds, node)) for node in nodes
        ]
        for node in self.nodes:
            node.open(timeout_s)
        self.drives = [CanOpenRawParameters(node, self.line) for node in self.nodes]
        self.bench.clock.sleep_s(0.01)  # boot-up messages have been sent
        self.journals = [Journal(folder / f"X{node}") for node in nodes]

    def values(self, keys: Sequence[tuple[int, int]], node: int = 0) -> list[int]:
        """The values in the drive."""
        return [list(self.bench.slaves.values())[node].dictionary.number(*key) for key in keys]


def shows_late(rig: ParameterRig, keys: Sequence[tuple[int, int]], node: int, delay_s: float) -> None:
    """This drive takes a value at once and shows it `delay_s` after the first look: until then it shows what it held."""
    dictionary, clock = rig.bench.slaves[node].dictionary, rig.bench.clock
    since: dict[tuple[int, int], int] = {}
    for key in keys:
        held = dictionary.raw(key)

        def shown(key: tuple[int, int] = key, held: bytes = held) -> int:
            now = dictionary.raw(key)
            if now != held:
                since.setdefault(key, clock.now_ns())
            late = now != held and clock.now_ns() - since[key] < delay_s * 1e9
            codec = dictionary.item(*key).codec
            assert codec is not None
            return int(codec.unpack(held if late else now)[0])

        dictionary.on_read(*key, shown)
