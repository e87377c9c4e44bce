"""Parameters of a drive: checked before they are written, proven after; the store of the simulated drive."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace

import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.eds import EdsFile, load_eds
from drivers.errors import (
    AbortError,
    InputError,
    ProtocolError,
)
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from sim_backends.canopen_drive import EDS
from sim_backends.canopen_faults import CanFault
from sim_backends.canopen_store import Flash

NODE = 5
LIMITS = DriveLimits(-200.0, 200.0, 200.0, 2000.0)
GAIN = "2210h:01"


@pytest.fixture(scope="module")
def eds() -> EdsFile:
    return load_eds(EDS, NODE)


class Rig:
    """One life of a drive; give the flash to the next."""

    def __init__(
        self, eds: EdsFile | None, *faults: CanFault, flash: Flash | None = None, bitrate: int | None = None
    ) -> None:
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
            eds=eds,
            settings=CanOpenSettings(sdo_timeout_s=0.1),
        )
        self.stack.enter_context(self.drive)
        self.parameters = self.drive.parameters

    def number(self, index: int, subindex: int = 0) -> int:
        return self.bench.slave.dictionary.number(index, subindex)


@pytest.fixture
def rig(eds: EdsFile) -> Iterator[Rig]:
    rig = Rig(eds)
    with rig.stack:
        yield rig


def test_a_drive_that_keeps_another_value_is_found_out(rig: Rig) -> None:
    rig.bench.slave.dictionary.on_read(0x2210, 1, lambda: 5)
    with pytest.raises(ProtocolError, match="2210h:01 Proportional gain was written 4321, it reads back 5"):
        rig.parameters.write(GAIN, 4321)


@pytest.mark.parametrize(
    ("name", "key", "values", "limits"),
    [
        (GAIN, (0x2210, 1), (1000, 400), (0, 500)),
        ("following_error_window", (0x6065, 0), (0xFFFF_FFFF, 20_000), (1, 100_000)),
        ("home_offset", (0x607C, 0), (-5, 50), (0, 100)),
    ],
)
def test_what_the_drive_was_found_with_can_be_put_back(
    eds: EdsFile, name: str, key: tuple[int, int], values: tuple[int, int], limits: tuple[int, int]
) -> None:
    held, new = values
    narrow = replace(eds.entries[key], low=limits[0], high=limits[1])
    rig = Rig(replace(eds, entries={**eds.entries, key: narrow}))
    with rig.stack:
        rig.bench.slave.dictionary.set_number(*key, held)
        assert rig.parameters.read(name) == held
        assert rig.parameters.write(name, new)
        assert rig.parameters.write(name, held)
        assert rig.number(*key) == held
        other = held - 1  # out of range as well, and never held
        with pytest.raises(InputError, match=rf"{other} is (above|below) its limit"):
            rig.parameters.write(name, other)
        assert rig.number(*key) == held


def test_all_writable_parameters_take_their_own_value(rig: Rig) -> None:
    writable = [name for name in rig.parameters.names if rig.parameters.describe(name).writable]
    assert GAIN in writable
    for name in writable:
        assert rig.parameters.write(name, rig.parameters.read(name)) is False


def test_without_an_eds_an_object_that_the_drive_lacks_is_left_out_and_a_refusal_is_raised() -> None:
    refused: list[int] = []

    def answer() -> int:
        if refused:
            raise AbortError("refused", refused[0])
        return 20_000

    rig = Rig(None)
    with rig.stack:
        rig.bench.slave.dictionary.on_read(0x6065, 0, answer)
        refused.append(0x0800_0022)  # not in the present state
        with pytest.raises(AbortError, match="refused"):
            _ = rig.parameters.names
        refused.clear()
        assert "following_error_window" in rig.parameters.names
    rig = Rig(None)
    with rig.stack:
        rig.bench.slave.dictionary.on_read(0x6065, 0, answer)
        refused.append(0x0602_0000)  # no such object
        assert "following_error_window" not in rig.parameters.names
        assert "home_offset" in rig.parameters.names


def test_an_unknown_object_is_refused(rig: Rig) -> None:
    with pytest.raises(InputError, match="has no parameter '5000h:00'"):
        rig.parameters.read("5000h:00")


# -- store ---------------------------------------------------------------------------------------------------


def test_an_enabled_axis_is_not_stored_from(rig: Rig) -> None:
    rig.drive.enable()
    with pytest.raises(AbortError, match="present device state"):
        rig.drive.sdo.write_bytes(0x1010, 1, b"save")


def test_a_wrong_signature_stores_nothing(rig: Rig) -> None:
    with pytest.raises(AbortError, match="cannot be transferred or stored"):
        rig.drive.sdo.write_bytes(0x1010, 1, b"SAVE")
    assert rig.flash.writes == 0
