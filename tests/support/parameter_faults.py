"""One download of 40 parameters with one fault at one frame, and the values in the drive afterwards.

The drive's RAM and flash are read directly, without a wire. Its flash holds the old values, so that a drive without power returns
to them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import can
from support.can_wire import SimWire, WirePort
from support.parameter_rigs import ParameterRig, maker_keys, maker_set

from drivers.canopen.bus import CanLink
from drivers.canopen.eds import EdsFile, load_eds
from drivers.canopen.node import Node
from drivers.canopen.raw_parameters import CanOpenRawParameters
from drivers.canopen.side_by_side import CanLine
from hil.parameters.download import download
from hil.parameters.recover import recover
from hil.parameters.report import Ending
from hil.parameters.transaction import Target
from sim_backends.canopen_faults import CanFault
from sim_backends.canopen_store import Flash
from sim_backends.faults import CanFaultKind

COUNT = 40
KEYS = maker_keys(COUNT)
OLD, NEW = maker_set(COUNT, seed=1), maker_set(COUNT, seed=2)
TIMEOUT_S = 0.05
OUTAGE_S = 30.0  # of a cable or a supply: longer than any retry


class KilledError(BaseException):
    """The process was killed: nothing after this moment happens."""


class DyingPort(WirePort):
    """A master's port whose process is killed at the n-th frame that it sends or receives; n 0: never."""

    def __init__(self, wire: SimWire, at_frame: int) -> None:
        super().__init__(wire)
        self.frames = 0
        self.at_frame = at_frame
        self.times_ns: list[int] = []

    def _count(self) -> None:
        self.frames += 1
        self.times_ns.append(self._wire.clock.now_ns())
        if self.at_frame and self.frames >= self.at_frame:
            raise KilledError

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        self._count()
        super().send(msg, timeout)

    def recv(self, timeout: float | None = None) -> can.Message | None:
        message = super().recv(timeout)
        if message is not None:
            self._count()
        return message


@lru_cache
def parsed(path: Path) -> EdsFile:
    return load_eds(path, 5)


def old_flash() -> Flash:
    """A drive's memory with the old values."""
    image = {}
    for key, entry in zip(KEYS, OLD.entries, strict=True):
        assert isinstance(entry.raw, int)
        size = {0x0: 4, 0x1: 2, 0x2: 1}[(key[1] - 1) % 3]
        image[key] = entry.raw.to_bytes(size, "little")
    flash = Flash(image)
    flash.checksum = flash.sealed()
    return flash


@dataclass(frozen=True)
class Run:
    """Result of one run. said: by the download, None where it was killed; at_last: after resume or rollback; held, flash: values in
    RAM and flash."""

    said: Ending | None
    at_last: Ending | None
    held: str
    flash: str
    frames: int
    times_ns: tuple[int, ...]
    stored: bool

    @property
    def whole(self) -> bool:
        """Whether the values are entirely old or entirely new, as reported."""
        told = self.at_last or self.said
        if told in (Ending.WRITTEN, Ending.UNCHANGED):
            return self.held == "new" and (not self.stored or self.flash == "new")
        if told in (Ending.PUT_BACK, Ending.REFUSED):
            return self.held == "old" and self.flash == "old"
        return told is None and self.held in ("old", "new") and self.flash in ("old", "new")


def one_run(
    eds: Path, folder: Path, *faults: CanFault, dies_at: int = 0, forward: bool = True, deaths: Sequence[int] = ()
) -> Run:
    """A download with these faults, in a new folder; then a resume or rollback, when the fault is over.

    deaths: frames at which successive attempts to finish it are killed.
    """
    flash = old_flash()
    rig = ParameterRig(eds, folder, faults=faults, flash=flash, timeout_s=TIMEOUT_S, file=parsed(eds))
    port = DyingPort(rig.bench.wire, dies_at)
    said, stored = None, False
    with CanLink(port, rig.bench.clock) as link:
        drive = _drive(link, eds)
        try:
            report = download([Target(drive, NEW, rig.journals[0])], store=True)[0]
            said, stored = report.ending, report.stored
        except KilledError:
            drive.clock.sleep_s(0.5)
    at_last = None
    for death in deaths:
        with CanLink(DyingPort(rig.bench.wire, death), rig.bench.clock) as link, suppress(KilledError):
            recover([(_drive(link, eds), rig.journals[0])], forward=forward)
    if rig.journals[0].unfinished() is not None:
        rig.bench.clock.sleep_s(OUTAGE_S)
        with CanLink(rig.bench.port(), rig.bench.clock) as link:
            last = recover([(_drive(link, eds), rig.journals[0])], forward=forward)[0]
            at_last, stored = last.ending, last.stored or stored
    return Run(said, at_last, _side(rig.values(KEYS)), _stored_side(flash), port.frames, tuple(port.times_ns), stored)


def _drive(link: CanLink, eds: Path) -> CanOpenRawParameters:
    node = Node("X5", link, 5, parsed(eds))
    node.open(TIMEOUT_S)
    return CanOpenRawParameters(node, CanLine(link))


def _side(values: list[int]) -> str:
    for name, contents in (("old", OLD), ("new", NEW)):
        if values == [entry.raw for entry in contents.entries]:
            return name
    return "neither"


def _stored_side(flash: Flash) -> str:
    values = [int.from_bytes(flash.image.get(key, b""), "little") for key in KEYS]
    return _side(values) if flash.intact else "torn"


# -- faults, at every frame --------------------------------------------------------------------------------------------
K = CanFaultKind
ANSWERED = {  # at the n-th SDO answer or request
    "late ack": (K.SDO_LATE, 1.6 * TIMEOUT_S),
    "late, past the quiet": (K.SDO_LATE, 8 * TIMEOUT_S),
    "lost reply": (K.SDO_LOST, 0.0),
    "lost request": (K.SDO_REQUEST_LOST, 0.0),
    "abort": (K.SDO_ABORTED, 0x06090030),
    "abort of a state": (K.SDO_ABORTED, 0x08000022),
    "wrong value read": (K.SDO_WRONG_VALUE, 0.0),
}
TIMED = {  # at the n-th frame's moment
    "node reboot": (K.REBOOT, 0.0),
    "cable pulled": (K.NODE_DEAD, OUTAGE_S),
    "cable pulled for a moment": (K.NODE_DEAD, 0.3),
    "power cut": (K.POWER_CUT, OUTAGE_S),
    "power cut for a moment": (K.POWER_CUT, 0.3),
}


def cases(clean: Run, name: str) -> Iterator[tuple[tuple[CanFault, ...], int]]:
    """(faults, frame at which the process dies) of every run of a kind."""
    if name == "process killed":
        yield from (((), frame) for frame in range(1, clean.frames + 1))
    elif name in ANSWERED:
        kind, size = ANSWERED[name]
        yield from (((CanFault(kind, size=size, count=1, skip=n),), 0) for n in range(clean.frames // 2))
    else:
        kind, lasts_s = TIMED[name]
        yield from (
            ((CanFault(kind, at_s=1e-9 * (time_ns + 1000), duration_s=lasts_s),), 0) for time_ns in clean.times_ns
        )


KINDS = (*ANSWERED, *TIMED, "process killed")
