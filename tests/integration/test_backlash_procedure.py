"""Backlash by torque over a drive: what it finds, and what it leaves behind on every way out."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import pytest
from support.backlash_axis import BenchBehind, lay_out, look_behind
from support.torque_machines import PUBLISHED, PublishedMachine, bench_of, laser_lost_motion_um, plant_of

from drivers.drive import Capability, DriveState, ServoDrive
from drivers.errors import (
    AbortError,
    BridgeError,
    CapabilityError,
    DriveFaultError,
    LimitError,
    LinkLostError,
    ProtocolError,
    StateError,
)
from hil.axis.axis_file import DriveAxis, load_drive_axis
from hil.axis.backlash import BacklashConfig
from hil.backlash.neutral_settings import BacklashSettings, NotRestoredError, restore
from hil.backlash.procedure import TorqueBacklash, measure_backlash
from hil.backlash.result import fitted_lost_motion
from hil.backlash.settings import backlash_settings
from hil.backlash.trace import ReversalTrace
from hil.machine.bench_wiring import running_bench
from hil.machine.events import Event
from hil.machine.wiring import connected_drive
from sim_backends.bench import BenchParameters, known_bench
from sim_backends.plant.drive_train import DriveTrain
from sim_backends.virtual_drive import VirtualDrive


@dataclass
class Kept:
    """A setting that remembers what was written; `refuse` raises what is to go wrong from the write of that number on."""

    name: str
    value: float
    resolution: float = 1.0
    writes: list[float] = field(default_factory=list)
    refuse: Callable[[int], BaseException | None] = lambda _number: None

    def read(self) -> float:
        return self.value

    def write(self, value: float) -> None:
        self.writes.append(value)
        error = self.refuse(len(self.writes))
        if error is not None:
            raise error
        self.value = value


@dataclass
class Rig:
    """An open drive on a bench, its two settings, and what was heard."""

    drive: VirtualDrive
    how: BacklashConfig
    settings: BacklashSettings
    amount: Kept
    switch: Kept
    bench: BenchBehind
    traces: list[tuple[int, ReversalTrace]] = field(default_factory=list)
    told: list[str] = field(default_factory=list)

    def measure(
        self, listener: Callable[[Event], None] = lambda _event: None, *, write: bool = False
    ) -> TorqueBacklash:
        return measure_backlash(
            self.drive,
            self.how,
            self.settings,
            write=write,
            keep=lambda run, trace: self.traces.append((run, trace)),
            listener=listener,
            tell=self.told.append,
        )


@contextmanager
def rig_on(directory: Path, behind: BenchBehind, bench: BenchParameters | None = None, **how: object) -> Iterator[Rig]:
    axis = load_drive_axis(lay_out(directory))
    assert axis.backlash is not None
    amount, switch = Kept("amount", 17.0), Kept("switch", 1.0)
    settings = BacklashSettings(amount, 1.0, switch, directory / "before.json")
    wanted = None if bench is None else [bench]
    with running_bench([axis], wanted) as running, connected_drive(axis, running) as drive:
        assert isinstance(drive, VirtualDrive)
        yield Rig(drive, replace(axis.backlash, **how), settings, amount, switch, behind)  # type: ignore[arg-type]


@pytest.fixture
def behind(monkeypatch: pytest.MonkeyPatch) -> BenchBehind:
    return look_behind(monkeypatch)


@pytest.fixture
def rig(tmp_path: Path, behind: BenchBehind) -> Iterator[Rig]:
    with rig_on(tmp_path, behind) as rig:
        yield rig


def as_before(rig: Rig) -> bool:
    return (rig.amount.value, rig.switch.value) == (17.0, 1.0) and not rig.settings.note.exists()


def at_step(number: int, act: Callable[[], None], reversal: int = 1) -> Callable[[Event], None]:
    """A listener that does something at a step of the n-th reversal."""
    stages: list[str] = []

    def listen(event: Event) -> None:
        if event.stage not in stages:
            stages.append(event.stage)
        if len(stages) == reversal and event.done == number and "µm" in event.message:
            act()

    return listen


# -- what it finds ---------------------------------------------------------------------------------------------------------
def test_both_reversals_their_mean_and_nothing_changed(rig: Rig) -> None:
    result = rig.measure()
    found = fitted_lost_motion(result.reversals)
    assert found is not None
    assert abs(found.mean_um - 53.0) <= found.u95_um < 1.5
    assert [one.trace.direction for one in result.reversals] == [-1, 1]
    assert result.written is None
    assert result.found.values == {"amount": 17.0, "switch": 1.0}
    assert rig.amount.writes == [0.0, 17.0]
    assert rig.switch.writes == [0.0, 1.0]
    assert as_before(rig)
    assert rig.drive.sample().state is DriveState.SWITCH_ON_DISABLED
    assert [run for run, _ in rig.traces] == [1, 1]


def test_an_axis_found_enabled_stays_enabled(rig: Rig) -> None:
    rig.drive.enable()
    rig.how = replace(rig.how, steps=20)
    rig.measure()
    assert rig.drive.sample().state is DriveState.ENABLED


def test_the_mean_is_written_only_when_asked_for_and_as_the_drive_can_hold_it(rig: Rig) -> None:
    rig.settings = replace(rig.settings, amount_um=0.25)
    result = rig.measure(write=True)
    assert result.lost_motion_um is not None
    assert rig.amount.value == result.written == round(result.lost_motion_um / 0.25)
    assert rig.amount.writes == [0.0, 17.0, result.written]
    assert rig.switch.value == 1.0


@pytest.mark.outside
def test_the_method_decides_what_is_written(rig: Rig) -> None:
    rig.how = replace(rig.how, method="four-sample")
    result = rig.measure(write=True)
    peaks = [one.published_um for one in result.reversals]
    assert result.lost_motion_um == pytest.approx(sum(peak for peak in peaks if peak is not None) / 2.0)
    assert rig.amount.value == round(result.lost_motion_um)


def test_a_small_backlash_with_finer_steps(tmp_path: Path, behind: BenchBehind) -> None:
    """The bench's typical machine: some µm, half of it a clearance of another form of friction."""
    parameters = known_bench("typical", 4)
    with rig_on(tmp_path, behind, parameters, step_um=0.2, readings=6) as rig:
        found = fitted_lost_motion(rig.measure().reversals)
        play_um = parameters.plant.backlash.amount_um
        assert found is not None
        assert found.mean_um == pytest.approx(play_um, abs=1.0)


@pytest.mark.parametrize("weight_n", [-1500.0, pytest.param(1500.0, marks=pytest.mark.outside)])
def test_a_vertical_axis_whose_torque_never_passes_zero(tmp_path: Path, behind: BenchBehind, weight_n: float) -> None:
    """15 % of rated hold the table, 9 % is friction. The published rule looks at |T| and cannot know."""
    train = replace(DriveTrain(), weight_n=weight_n)
    laser_um = laser_lost_motion_um(train)
    with rig_on(tmp_path, behind, BenchParameters(plant=plant_of(train))) as rig:
        result = rig.measure()
    found = fitted_lost_motion(result.reversals)
    assert found is not None
    assert abs(found.mean_um - laser_um) <= found.u95_um
    assert [one.trace.weight_percent for one in result.reversals] == pytest.approx([weight_n / 100.0] * 2, abs=0.3)


# -- every way out -----------------------------------------------------------------------------------------------------------
def test_no_break_away_within_the_steps_puts_everything_back(rig: Rig) -> None:
    rig.how = replace(rig.how, steps=20)
    result = rig.measure(write=True)
    assert result.lost_motion_um is None
    assert result.exceeded is result.reversals[0]
    assert len(result.reversals) == 1, "the second reversal is of no use then"
    assert len(result.reversals[0].trace.position_load_mm) == 21
    assert result.written is None
    assert as_before(rig)
    assert rig.drive.sample().state is DriveState.SWITCH_ON_DISABLED


def test_a_fault_on_the_way(rig: Rig) -> None:
    with pytest.raises(DriveFaultError) as caught:
        rig.measure(at_step(12, lambda: rig.bench.bench.servo.raise_fault(0x3210), reversal=2))
    assert caught.value.code == 0x3210
    assert as_before(rig)
    assert [len(trace.position_load_mm) for _, trace in rig.traces][1] == 13, "what was measured is kept"


def test_power_that_goes_by_itself(rig: Rig) -> None:
    with pytest.raises(StateError, match=r"ended by itself|it is switch on disabled"):
        rig.measure(at_step(9, rig.bench.bench.servo.power_off))
    assert as_before(rig)


def test_ctrl_c_stops_the_axis_first(rig: Rig) -> None:
    def interrupt() -> None:
        rig.drive.start_move(60.0, 50.0)
        raise KeyboardInterrupt

    stopped_before: list[float] = []
    stop = rig.drive.quick_stop
    rig.drive.quick_stop = lambda: (stopped_before.append(rig.amount.value), stop())[1]  # type: ignore[method-assign]
    with pytest.raises(KeyboardInterrupt):
        rig.measure(at_step(10, interrupt))
    assert stopped_before == [0.0], "stopped before anything is put back"
    assert as_before(rig)
    sample = rig.drive.sample()
    assert sample.state is DriveState.SWITCH_ON_DISABLED
    assert sample.velocity_mm_s == 0.0
    assert len(rig.traces) == 1


def test_ctrl_c_while_it_is_put_back_waits_until_all_is(rig: Rig) -> None:
    rig.how = replace(rig.how, steps=20)
    rig.switch.refuse = lambda number: KeyboardInterrupt() if number == 2 else None
    with pytest.raises(KeyboardInterrupt):
        rig.measure()
    assert as_before(rig)


@pytest.mark.parametrize("error", [LinkLostError("bus gone"), AbortError("refused", 0x08000022)])
def test_what_cannot_be_put_back_is_said_and_kept_for_later(rig: Rig, error: BridgeError) -> None:
    rig.amount.refuse = lambda number: error if number >= 2 else None

    def lose() -> None:
        raise LinkLostError("bus gone at step 10")

    with pytest.raises(LinkLostError, match="at step 10"):
        rig.measure(at_step(10, lose))
    assert rig.switch.value == 1.0, "what could be put back was"
    assert len(rig.told) == 1
    assert "amount was 17" in rig.told[0]
    assert json.loads(rig.settings.note.read_text()) == {"amount": 17.0, "switch": 1.0}

    rig.amount.refuse = lambda _number: None
    found = restore(rig.settings)
    assert found is not None
    assert found.from_note
    assert as_before(rig)
    assert restore(rig.settings) is None


def test_when_nothing_else_went_wrong_a_failed_restore_is_the_error(rig: Rig) -> None:
    rig.how = replace(rig.how, steps=20)
    rig.amount.refuse = lambda number: AbortError("refused", 0x08000022) if number == 2 else None
    with pytest.raises(NotRestoredError, match=r"amount was 17 .*--restore"):
        rig.measure()


def test_after_a_measurement_that_was_killed_the_first_values_count(rig: Rig) -> None:
    rig.settings.note.write_text('{"amount": 23, "switch": 1}')
    rig.amount.value = rig.switch.value = 0.0
    rig.how = replace(rig.how, steps=20)
    result = rig.measure()
    assert result.found.from_note
    assert (rig.amount.value, rig.switch.value) == (23.0, 1.0)


def test_a_refusal_to_zero_the_second_puts_the_first_back(rig: Rig) -> None:
    rig.switch.refuse = lambda number: AbortError("refused", 0x08000022) if number == 1 else None
    with pytest.raises(AbortError):
        rig.measure()
    assert rig.amount.value == 17.0
    assert not rig.bench.bench.servo.homed, "nothing was moved"


@pytest.mark.outside
def test_a_drive_that_takes_another_value_than_it_was_given(rig: Rig) -> None:
    class Deaf(Kept):
        def write(self, value: float) -> None:
            super().write(min(value, 20.0))

    deaf = Deaf("amount", 17.0)
    rig.settings = replace(rig.settings, amount=deaf)
    with pytest.raises(ProtocolError, match="reads back 20"):
        rig.measure(write=True)


# -- said before moving --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("missing", [Capability.TORQUE_ACTUAL, Capability.PROFILE_POSITION, Capability.HOMING])
def test_what_the_drive_cannot_do_is_said_before_anything_is_written(rig: Rig, missing: Capability) -> None:
    rig.drive.settings.missing = frozenset({missing})
    with pytest.raises(CapabilityError, match=missing.value):
        rig.measure()
    assert rig.amount.writes == []
    assert not rig.bench.bench.servo.powered


def test_a_torque_that_is_never_told(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    told = rig.drive.sample
    monkeypatch.setattr(rig.drive, "sample", lambda: replace(told(), torque_percent=None))
    with pytest.raises(CapabilityError, match="does not report its torque"):
        rig.measure()
    assert rig.amount.writes == []


def test_a_way_out_of_the_travel(rig: Rig) -> None:
    rig.how = replace(rig.how, reference_plus_mm=5.0, reference_minus_mm=501.5)
    with pytest.raises(LimitError, match="nothing was moved"):
        rig.measure()
    assert rig.amount.writes == []


# -- the published machines, through the drive -----------------------------------------------------------------------------------
@pytest.mark.outside
@pytest.mark.parametrize("machine", PUBLISHED, ids=[machine.name for machine in PUBLISHED])
def test_five_runs_are_within_one_per_cent_of_the_laser(
    machine: PublishedMachine,
    tmp_path: Path,
    behind: BenchBehind,
) -> None:
    laser_um = laser_lost_motion_um(machine.train, machine.load_kg)
    with rig_on(tmp_path, behind, bench_of(machine, seed=11), runs=5, step_um=1.0, settle_s=0.1, readings=4) as rig:
        rig.bench.bench.plant.load_kg = machine.load_kg
        result = rig.measure()
    found = fitted_lost_motion(result.reversals)
    assert found is not None
    assert abs(found.mean_um - laser_um) <= 0.01 * laser_um
    assert abs(found.mean_um - laser_um) <= found.u95_um


# -- the drive's own parameters, over its wire -------------------------------------------------------------------------------------
def lost_motion_at_the_table_um(drive: ServoDrive, behind: BenchBehind) -> float:
    """The laser's way on the running bench: one place reached upwards and downwards."""
    places = []
    drive.enable()
    for start in (4.8, 5.2):
        for target in (start, 5.0):
            drive.start_move(target, 5.0)
            drive.wait_for(lambda sample: sample.target_reached, 20.0, "arrived")
            drive.clock.sleep_s(0.3)
        places.append(behind.bench.plant.position_mm)
    drive.disable()
    return (places[1] - places[0]) * 1000.0


def measured_and_written(axis: DriveAxis, behind: BenchBehind) -> tuple[TorqueBacklash, float]:
    """The measurement, and what the table still loses with its amount in force; without it the machine loses 53 µm."""
    assert axis.backlash is not None
    with connected_drive(axis) as drive:
        settings = backlash_settings(axis, axis.backlash, drive)
        for setting in settings.settings():
            setting.write(1.0)
        result = measure_backlash(drive, axis.backlash, settings, write=True)
        assert [setting.read() for setting in settings.settings()][1:] == [1.0], "the switch is as it was"
        return result, lost_motion_at_the_table_um(drive, behind)


def test_over_canopen_the_written_amount_takes_the_lost_motion_away(tmp_path: Path, behind: BenchBehind) -> None:
    result, left_um = measured_and_written(load_drive_axis(lay_out(tmp_path, "canopen")), behind)
    assert abs(left_um) < 1.2
    assert result.written == pytest.approx(100.0 * (result.lost_motion_um or 0.0), abs=0.5)


@pytest.mark.outside
def test_the_same_over_modbus(tmp_path: Path, behind: BenchBehind) -> None:
    _, left_um = measured_and_written(load_drive_axis(lay_out(tmp_path, "modbus-tcp")), behind)
    assert abs(left_um) < 1.2


@pytest.mark.outside
def test_over_a_serial_line_of_a_drive_without_a_parameter(tmp_path: Path) -> None:
    axis = load_drive_axis(lay_out(tmp_path, "modbus-rtu"))
    assert axis.backlash is not None
    with connected_drive(axis) as drive:
        settings = backlash_settings(axis, axis.backlash, drive)
        with pytest.raises(StateError, match="has no backlash parameter that could hold an amount"):
            measure_backlash(drive, axis.backlash, settings, write=True)
        result = measure_backlash(drive, axis.backlash, settings)
    found = fitted_lost_motion(result.reversals)
    assert found is not None
    assert abs(found.mean_um - 53.0) <= found.u95_um
    assert result.written is None


def test_a_register_that_could_be_zeroed_but_not_put_back_is_refused_first(tmp_path: Path) -> None:
    """Its EEPROM bears two more writes."""
    path = lay_out(tmp_path, "modbus-tcp")
    path.write_text(path.read_text().replace('"backlash"', '"origin_offset"'))
    axis = load_drive_axis(path)
    axis.store.directory.mkdir()
    (axis.store.directory / "eeprom-writes.json").write_text('{"X/origin_offset": 18}')
    assert axis.backlash is not None
    with connected_drive(axis) as drive, pytest.raises(StateError, match="has 2 writes left, a measurement takes 3"):
        backlash_settings(axis, axis.backlash, drive)


def test_a_bus_that_is_lost_on_the_way(tmp_path: Path, behind: BenchBehind) -> None:
    axis = load_drive_axis(lay_out(tmp_path, "canopen"))
    assert axis.backlash is not None
    told: list[str] = []
    with connected_drive(axis) as drive:
        settings = backlash_settings(axis, axis.backlash, drive)
        settings.amount.write(1234.0)

        def cut() -> None:
            drive.link.send = gone  # type: ignore[attr-defined]

        def gone(*_args: object) -> None:
            raise LinkLostError("CAN adapter unplugged")

        with pytest.raises(LinkLostError, match="unplugged"):
            measure_backlash(drive, axis.backlash, settings, listener=at_step(5, cut), tell=told.append)
    assert len(told) == 1
    assert "2201h was 1234" in told[0]
    assert json.loads(settings.note.read_text())["2201h"] == 1234
