"""Parameters of a drive: checked before they are written, proven after; the store of the simulated drive."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import pytest

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.eds import EdsFile, load_eds
from drivers.canopen.parameters import CanOpenParameters
from drivers.cia402.objects import DataType
from drivers.drive import DriveLimits
from drivers.errors import (
    AbortError,
    InputError,
    ProtocolError,
)
from drivers.scaling import AxisScaling
from sim_backends.canopen_bench import CanBench
from sim_backends.canopen_drive import EDS
from sim_backends.canopen_faults import CanFault
from sim_backends.canopen_store import Flash

NODE = 5
LIMITS = DriveLimits(-200.0, 200.0, 200.0, 2000.0)
GAIN = (0x2210, 1)


@pytest.fixture(scope="module")
def eds() -> EdsFile:
    return load_eds(EDS, NODE)


class Rig:
    """One life of a drive; give the flash to the next."""

    def __init__(self, eds: EdsFile, *faults: CanFault, flash: Flash | None = None, bitrate: int | None = None) -> None:
        self.flash = flash if flash is not None else Flash()
        self.bench = CanBench((NODE,), bitrate, {NODE: faults}, flash=self.flash)
        self.stack = ExitStack()
        self.link = self.stack.enter_context(CanLink(self.bench.port(), self.bench.clock))
        self.drive = CanOpenDrive(
            "X",
            AxisScaling(100_000, 10.0),
            LIMITS,
            self.bench.clock,
            link=self.link,
            node_id=NODE,
            settings=CanOpenSettings(sdo_timeout_s=0.1),
        )
        self.stack.enter_context(self.drive)
        self.parameters = CanOpenParameters(self.drive.node, eds)

    def number(self, index: int, subindex: int = 0) -> int:
        return self.bench.slave.dictionary.number(index, subindex)


@pytest.fixture
def rig(eds: EdsFile) -> Iterator[Rig]:
    rig = Rig(eds)
    with rig.stack:
        yield rig


def test_a_drive_that_keeps_another_value_is_found_out(rig: Rig) -> None:
    dictionary = rig.bench.slave.dictionary
    dictionary.on_read(*GAIN, lambda: 5)
    with pytest.raises(ProtocolError, match="2210h:01 Proportional gain was written 4321, it reads back 5"):
        rig.parameters.write(rig.parameters.find(*GAIN), 4321)


@pytest.mark.parametrize(
    ("key", "held", "new", "limits"),
    [(GAIN, 1000, 400, (0, 500)), ((0x6065, 0), 0xFFFF_FFFF, 20_000, (1, 100_000)), ((0x607C, 0), -5, 50, (0, 100))],
)
def test_what_the_drive_was_found_with_can_be_put_back(
    rig: Rig, key: tuple[int, int], held: int, new: int, limits: tuple[int, int]
) -> None:
    rig.bench.slave.dictionary.set_number(*key, held)
    found = replace(rig.parameters.find(*key), low=limits[0], high=limits[1])
    assert rig.parameters.read(found).value == held
    rig.parameters.write(found, new)
    rig.parameters.write(found, held)
    assert rig.number(*key) == held
    other = held - 1  # out of range as well, and never held
    with pytest.raises(InputError, match=rf"{other} is (above|below) its limit"):
        rig.parameters.write(found, other)


def test_all_writable_parameters_take_their_own_value(rig: Rig) -> None:
    for found in rig.parameters.writable():
        if found.entry.type is not DataType.STRING and found.entry.index not in (
            0x1005,
            0x1006,
            0x1014,
            0x1016,
            0x1017,
        ):
            rig.parameters.write(found, rig.parameters.read(found).value)


def test_an_unknown_object_is_refused_with_the_file(rig: Rig) -> None:
    with pytest.raises(InputError, match=r"servo_drive.eds: has no object 5000h:00"):
        rig.parameters.find(0x5000)


# -- store ---------------------------------------------------------------------------------------------------


def test_an_enabled_axis_is_not_stored_from(rig: Rig) -> None:
    rig.drive.enable()
    with pytest.raises(AbortError, match="present device state"):
        rig.drive.sdo.write_bytes(0x1010, 1, b"save")


def test_a_wrong_signature_stores_nothing(rig: Rig) -> None:
    with pytest.raises(AbortError, match="cannot be transferred or stored"):
        rig.drive.sdo.write_bytes(0x1010, 1, b"SAVE")
    assert rig.flash.writes == 0
