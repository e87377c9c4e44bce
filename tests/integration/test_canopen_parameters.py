"""Parameters of a drive: checked, proven, stored when that is safe - and what a power cut during a store leaves behind."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.eds import EdsFile, load_eds
from drivers.canopen.objects import DataType
from drivers.canopen.parameters import CanOpenParameters
from drivers.canopen.sdo_cost import download_frames, upload_frames, wire_time
from drivers.drive import DriveLimits, DriveState
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    InputError,
    LinkLostError,
    NoAnswerError,
    ProtocolError,
    StateError,
)
from drivers.scaling import AxisScaling
from sim_backends.canopen_bench import CanBench
from sim_backends.canopen_drive import EDS
from sim_backends.canopen_faults import CanFault, CanFaultKind
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


def test_a_whole_snapshot(rig: Rig) -> None:
    steps: list[int] = []
    snapshot = rig.parameters.snapshot(progress=lambda done, _all: steps.append(done))
    assert snapshot[0x1008, 0].value == "Simulated feed axis servo drive"
    assert snapshot[GAIN].value == 1000
    assert snapshot[0x605A, 0].value == 2
    assert len(snapshot) > 200
    assert steps == list(range(1, len(steps) + 1))


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


# -- store and restore ---------------------------------------------------------------------------------------------------


def test_what_was_stored_is_there_after_the_next_start(eds: EdsFile) -> None:
    flash = Flash()
    first = Rig(eds, flash=flash)
    with first.stack:
        first.parameters.write(first.parameters.find(*GAIN), 777)
        first.drive.store_parameters()
        first.parameters.write(first.parameters.find(0x605A), 6)  # not stored
    assert flash.intact
    assert flash.writes == 1
    second = Rig(eds, flash=flash)
    with second.stack:
        assert second.parameters.read(second.parameters.find(*GAIN)).value == 777
        assert second.parameters.read(second.parameters.find(0x605A)).value == 2


def test_a_restart_brings_defaults_back(rig: Rig) -> None:
    gain = rig.parameters.find(*GAIN)
    rig.parameters.write(gain, 777)
    rig.drive.store_parameters()
    rig.drive.restore_defaults()
    assert rig.parameters.read(gain).value == 777  # until the next start
    rig.drive.restart()
    assert rig.parameters.read(gain).value == 1000
    rig.drive.enable()
    assert rig.drive.sample().state is DriveState.ENABLED


def test_targets_are_harmless_before_a_store(rig: Rig) -> None:
    """This drive stores its target like the real ones that do: it must be where the axis is."""
    rig.drive.enable()
    rig.drive.start_move(50.0, 100.0)
    rig.drive.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")
    rig.drive.start_move(150.0, 100.0)
    rig.bench.clock.sleep_s(0.3)
    rig.drive.disable()
    rig.bench.clock.sleep_s(0.5)
    rig.drive.store_parameters()
    stored = int.from_bytes(rig.flash.image[0x607A, 0], "little", signed=True)
    assert stored == rig.bench.servo.position_actual_counts
    assert stored != 1_500_000


def test_an_enabled_axis_is_not_stored_from(rig: Rig) -> None:
    rig.drive.enable()
    for refused in (rig.drive.store_parameters, rig.drive.restore_defaults):
        with pytest.raises(StateError, match="disable it first"):
            refused()
    with pytest.raises(AbortError, match="present device state"):
        rig.drive.sdo.write_bytes(0x1010, 1, b"save")
    with pytest.raises(StateError, match="cannot be restarted"):
        rig.drive.restart()


def test_a_wrong_signature_stores_nothing(rig: Rig) -> None:
    with pytest.raises(AbortError, match="cannot be transferred or stored"):
        rig.drive.sdo.write_bytes(0x1010, 1, b"SAVE")
    assert rig.flash.writes == 0


def test_a_drive_that_does_not_store_on_command_says_so(rig: Rig) -> None:
    rig.bench.slave.dictionary.on_read(0x1010, 1, lambda: 2)
    with pytest.raises(CapabilityError, match="not done on command"):
        rig.drive.store_parameters()


@pytest.mark.parametrize("cut_s", [0.01, 0.05, 0.1, 0.149])
def test_a_power_cut_during_the_store_is_noticed_on_both_sides(eds: EdsFile, cut_s: float) -> None:
    flash = Flash()
    probe = Rig(eds)
    with probe.stack:
        probe.parameters.write(probe.parameters.find(*GAIN), 777)
        begun_s = probe.bench.clock.now_ns() / 1e9
    cut = CanFault(CanFaultKind.POWER_CUT, at_s=begun_s + cut_s, duration_s=100.0)
    rig = Rig(eds, cut, flash=flash)
    with rig.stack:
        rig.parameters.write(rig.parameters.find(*GAIN), 777)
        with pytest.raises((NoAnswerError, LinkLostError)):
            rig.drive.store_parameters(timeout_s=1.0)
    assert not flash.intact
    second = Rig(eds, flash=flash)
    with second.stack:
        assert second.number(0x1003, 1) == 0x5530
        assert second.parameters.read(second.parameters.find(*GAIN)).value == 1000


def test_the_prediction_is_a_lower_bound_that_comes_close(eds: EdsFile) -> None:
    rig = Rig(eds, bitrate=1_000_000)
    with rig.stack:
        writes = dict.fromkeys([(0x2210, 1), (0x2210, 2), (0x6067, 0), (0x6068, 0), (0x605D, 0)], 2)
        data = [(*key, eds.entries[key].entry.pack(value)) for key, value in writes.items()]
        frames = [frame for each in data for frame in (*download_frames(*each), *upload_frames(*each))]
        predicted_s = wire_time(NODE, frames, 1_000_000).seconds_least
        start_ns = rig.bench.clock.now_ns()
        for key, value in writes.items():
            rig.parameters.write(rig.parameters.find(*key), value)
        measured_s = (rig.bench.clock.now_ns() - start_ns) * 1e-9
        assert predicted_s <= measured_s <= 1.25 * predicted_s


def test_errors_are_ours(rig: Rig) -> None:
    rig.link.bus.shutdown()
    with pytest.raises(BridgeError):
        rig.parameters.read(rig.parameters.find(*GAIN))
