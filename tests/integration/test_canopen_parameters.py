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
from drivers.canopen.sdo_cost import transfer
from drivers.cia402.objects import DataType
from drivers.drive import DriveLimits
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
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


def test_reading_says_how_long_it_took(eds: EdsFile) -> None:
    rig = Rig(eds, bitrate=1_000_000)
    with rig.stack:
        access = rig.parameters.read(rig.parameters.find(*GAIN))
        assert access.value == 1000
        assert 222e-6 <= access.seconds <= 270e-6  # the published range of one expedited transfer at 1 Mbit/s


def test_a_write_is_proven(rig: Rig) -> None:
    gain = rig.parameters.find(*GAIN)
    rig.parameters.write(gain, 4321)
    assert rig.number(*GAIN) == 4321
    text = rig.parameters.find(0x2101)
    rig.parameters.write(text, "commissioned on a Tuesday")
    assert rig.parameters.read(text).value == "commissioned on a Tuesday"


def test_a_drive_that_keeps_another_value_is_found_out(rig: Rig) -> None:
    dictionary = rig.bench.slave.dictionary
    dictionary.on_read(*GAIN, lambda: 5)
    with pytest.raises(ProtocolError, match="2210h:01 Proportional gain was written 4321, it reads back 5"):
        rig.parameters.write(rig.parameters.find(*GAIN), 4321)


@pytest.mark.parametrize("value", [1_000_001, -1, 3.5, 2**32])
def test_limits_and_types_are_kept_before_the_wire(rig: Rig, value: float) -> None:
    transfers = rig.drive.sdo.counters.transfers
    with pytest.raises(InputError, match="Proportional gain"):
        rig.parameters.write(rig.parameters.find(*GAIN), value)
    assert rig.drive.sdo.counters.transfers == transfers


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


@pytest.mark.parametrize(
    ("index", "subindex", "why"),
    [
        (0x6040, 0, "moves the axis"),
        (0x607A, 0, "moves the axis"),
        (0x60FF, 0, "moves the axis"),
        (0x6041, 0, "read only"),
        (0x1010, 1, "is a command"),
        (0x1A00, 1, "belongs to the PDO mapping"),
    ],
)
def test_what_is_no_parameter_is_refused(rig: Rig, index: int, subindex: int, why: str) -> None:
    with pytest.raises(CapabilityError, match=why):
        rig.parameters.write(rig.parameters.find(index, subindex), 0)


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


def test_the_prediction_is_an_upper_bound_that_comes_close(eds: EdsFile) -> None:
    rig = Rig(eds, bitrate=1_000_000)
    with rig.stack:
        writes = dict.fromkeys([(0x2210, 1), (0x2210, 2), (0x6067, 0), (0x6068, 0), (0x605D, 0)], 2)
        sizes = [len(eds.entries[key].entry.pack(value)) for key, value in writes.items()]
        predicted_s = 2 * sum(transfer(size, 1_000_000).seconds for size in sizes)
        start_ns = rig.bench.clock.now_ns()
        for key, value in writes.items():
            rig.parameters.write(rig.parameters.find(*key), value)
        measured_s = (rig.bench.clock.now_ns() - start_ns) * 1e-9
        assert 0.8 * predicted_s <= measured_s <= predicted_s


def test_errors_are_ours(rig: Rig) -> None:
    rig.link.bus.shutdown()
    with pytest.raises(BridgeError):
        rig.parameters.read(rig.parameters.find(*GAIN))
