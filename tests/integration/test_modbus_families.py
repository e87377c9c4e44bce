"""Every shipped map of a maker's Modbus drive: what works over a foreign stack, and what `hil doctor` finds when the map is wrong."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from study.modbus_families import FEED_MM, HOW, LIMITS, Result, Rig, Scale, exercise, failures, family, table
from support.maker_drives import (
    FAMILIES,
    A6Rs,
    Aasd15a,
    Akd2g,
    AppliedMotion,
    DeltaAsdaA2,
    InovanceSv660,
    LeadshineEl7,
    LichuanA5,
    LichuanA6,
    served_on_a_line,
)

from drivers.drive import DriveState
from drivers.errors import MotionTimeoutError, ProtocolError, StateError
from drivers.modbus.map_facts import FactLedger
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_map import find_map
from drivers.scaling import AxisScaling
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.doctor.procedure import doctor
from hil.machine.axis_lock import modbus_endpoint
from hil.machine.session import AxisSession
from sim_backends.clock import SimClock

DIRECTION = {"oriental_az": "0x007c"}  # left as the driver leaves it: without current, though it was found excited
CAUGHT_WITHIN_MM = 1.0
USUAL = ("delta_asda_a2", "leadshine_el7", "mitsubishi_mr_je_c", "oriental_az")
"""A relative target, an order register, the standard's objects, a velocity in Hz: what proves a map or finds it wrong is one code."""


def each_family(*more: object) -> list[object]:
    """All families, each with its item of each of `more`; the unusual ones are not of the default tests."""
    rows = zip(FAMILIES, *more, strict=True)
    return [pytest.param(*row, marks=() if row[0] in USUAL else pytest.mark.outside) for row in rows]


@contextmanager
def examined(name: str, **how: object) -> Iterator[tuple[Rig, AxisSession]]:
    with family(name, **how) as rig, AxisSession(rig.drive, Scale(rig), HOW) as session:  # type: ignore[arg-type]
        yield rig, session


def travelled_mm(rig: Rig) -> float:
    """How far the motor was from where it stood, in either direction."""
    start = rig.maker.start_counts
    return max(rig.maker.highest - start, start - rig.maker.lowest) * FEED_MM / rig.maker.counts_per_rev


# -- right maps --------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def exercised() -> dict[str, Result]:
    return {name: exercise(name) for name in FAMILIES}


@pytest.mark.parametrize("name", FAMILIES)
def test_a_family_does_everything_its_file_describes(name: str, exercised: dict[str, Result]) -> None:
    result = exercised[name]
    assert abs(result.speed_percent) < 1.0
    assert abs(result.distance_mm) < 0.002
    assert abs(result.stop_mm) < 3.0
    assert result.changed == ((DIRECTION[name],) if name in DIRECTION else ())
    assert result.homing == "yes" or load_drive_map(name).without_homing.startswith(result.homing)


def test_the_table_of_the_documentation_is_the_one_printed(exercised: dict[str, Result]) -> None:
    page = Path(__file__).parents[2] / "hil" / "docs" / "drives_tested.md"
    assert table(list(exercised.values())) in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("name", each_family())
def test_the_doctor_proves_what_was_assumed_and_only_then_it_is_used(name: str, tmp_path: Path) -> None:
    with examined(name) as (rig, session):
        drive = rig.drive
        drive._ledger = FactLedger(tmp_path / "facts.json", "here", find_map(name))
        if drive.unproven() - {"homing"} and drive.sample().state is not DriveState.ENABLED:
            with pytest.raises(StateError, match="not proven on this drive"):
                drive.enable()
            assert not rig.maker.servo.powered
        checks = doctor(session)
        assert not failures(checks)
        assert drive.unproven() <= {"homing"}
        drive.enable()
        if drive.map.homing is not None:
            if drive.unproven():
                with pytest.raises(StateError, match=r"hil doctor AXIS\.toml --home"):
                    drive.start_homing()
            assert not failures(doctor(session, home=True))
            assert not drive.unproven()
            drive.enable()
            drive.start_homing()


# -- what a family is known for ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["delta_asda_a2", "lichuan_a5", "inovance_sv660", "stepperonline_a6_rs"])
def test_nothing_but_the_switch_itself_is_written_while_writes_are_stored(name: str) -> None:
    with family(name) as rig, rig.drive.proving(), rig.drive:
        rig.drive.enable()
        rig.drive.start_move(20.0, 50.0)
        rig.drive.wait_for(lambda sample: sample.target_reached, 10.0, "arrived")
    assert rig.maker.stored <= 1  # type: ignore[attr-defined]  # Delta's switch counts as a write of its own
    assert rig.maker.memory() == rig.maker.found


class Unmapped(Akd2g):
    mapped = False


def test_a_drive_that_swallows_writes_is_found_out_by_reading_back_and_by_its_state() -> None:
    with family("kollmorgen_akd2g", maker=Unmapped) as rig, rig.drive.proving(), rig.drive:
        with pytest.raises(MotionTimeoutError, match=r"is MODBUS.MAP 40201 AXIS1.EN typed\?"):
            rig.drive.enable()
        del rig.maker.rows[28]  # MT.V of the default map
        with pytest.raises(
            ProtocolError, match=r"task_speed \(holding 0x001c\) was written as 60000, acknowledged, and reads 0"
        ):
            rig.drive.access.write({"task_speed": 60_000})


class Unassigned(LichuanA5):
    outputs_from_factory = ()


def test_a_state_by_outputs_that_nobody_assigned_is_not_believed() -> None:
    with family("lichuan_a5", maker=Unassigned) as rig:
        with pytest.raises(
            StateError, match=r"virtual_outputs \(holding 0x0c0b\) reads 0x0, expected 0x1: the drive's state"
        ):
            rig.drive.open()
        assert rig.maker.memory() == rig.maker.found


class OtherMonitor(DeltaAsdaA2):
    monitor = 7


def test_a_monitor_that_shows_something_else_is_no_position() -> None:
    with (
        family("delta_asda_a2", maker=OtherMonitor) as rig,
        pytest.raises(StateError, match=r"monitor_choice \(holding 0x0022\) reads 0x7, expected 0x0: .*set P0-17 = 0"),
    ):
        rig.drive.open()


class Di5(InovanceSv660):
    def table(self) -> None:
        super().table()
        self.rows[0x030A].value = 1


def test_two_inputs_with_servo_on_are_refused_before_they_make_an_alarm() -> None:
    with family("inovance_sv660", maker=Di5) as rig:
        with pytest.raises(StateError, match=r"alarm E122\.5; set H03\.10 = 0"):
            rig.drive.open()
        assert not rig.maker.servo.fault_code


class HomeNotMapped(Akd2g):
    def table(self) -> None:
        super().table()
        del self.rows[208]


def test_a_homing_order_that_nobody_mapped_is_named_and_the_axis_switched_off() -> None:
    with family("kollmorgen_akd2g", maker=HomeNotMapped) as rig, rig.drive.proving(), rig.drive:
        rig.drive.enable()
        with pytest.raises(MotionTimeoutError, match=r"is MODBUS\.MAP 40209 AXIS1\.HOME\.MOVE typed\?"):
            rig.drive.start_homing()
        assert not rig.maker.servo.powered


def test_a_drive_that_homes_as_its_power_comes_on_does_so_once() -> None:
    with family("inovance_sv660") as rig, rig.drive.proving(), rig.drive:
        drive, maker = rig.drive, rig.maker
        drive.enable()
        drive.start_homing()
        drive.wait_for(lambda sample: bool(sample.homed), 60.0, "homed")
        drive.start_move(20.0, 50.0)
        drive.wait_for(lambda sample: sample.target_reached, 10.0, "arrived")
        drive.disable()
        assert maker[0x051E] == 4  # as the drive leaves it
        drive.enable()
        rig.clock.sleep_s(1.0)
        assert maker[0x051E] == 0
        assert abs(rig.true_mm() - 20.0) < 0.002
    assert maker[0x051E] == maker.found[0x051E]


def test_an_axis_that_would_fall_is_not_switched_off_to_home() -> None:
    with family("inovance_sv660") as rig, rig.drive.proving(), rig.drive:
        rig.drive.enable()
        rig.drive.falls_without_power = True
        with pytest.raises(StateError, match="homes only as its power comes on"):
            rig.drive.start_homing()
        assert rig.maker.servo.powered
        rig.drive.falls_without_power = False


@pytest.mark.parametrize("name", FAMILIES)
def test_a_makers_number_of_a_homing_method_is_never_explained_as_the_standards(name: str) -> None:
    homing = load_drive_map(name).homing
    if homing is None or homing.method is None:
        return
    with family(name) as rig, rig.drive:
        zero = rig.drive.zero()
        number = rig.drive.access.read((homing.method,))[homing.method]
    if name in ("mitsubishi_mr_je_c", "stepperonline_a6_rs"):  # 6098h; 34 and 35 as in the standard
        assert zero.method == number
    else:
        assert zero.method is None
        assert zero.identity["homing by the maker's method"] == number


class Do4NotAssigned(A6Rs):
    def table(self) -> None:
        super().table()
        self.rows[0x4005].read = lambda: 0


def test_a_homing_whose_end_no_output_shows_is_never_taken_for_done() -> None:
    with family("stepperonline_a6_rs", maker=Do4NotAssigned) as rig, rig.drive.proving(), rig.drive:
        rig.drive.enable()
        rig.drive.start_homing()
        rig.clock.sleep_s(20.0)
        assert rig.maker.servo.homed
        assert rig.drive.sample().homed is False


class NoFilter(Aasd15a):
    def table(self) -> None:
        super().table()
        self.rows[109].value = 0


def test_moves_without_a_ramp_are_refused() -> None:
    with (
        family("aasd_15a", maker=NoFilter) as rig,
        pytest.raises(StateError, match=r"reads 0x0, expected 0x1 or 0x2: without a filter .* set Pn109 = 2"),
    ):
        rig.drive.open()


class Absolute(Aasd15a):
    """Its internal position is a place, not a distance."""

    def _inputs_2(self, before: int, now: int) -> None:
        if now & 1 << 10 and not before & 1 << 10 and self.servo.powered:
            self.servo.move_absolute(10_000 * self[120] + self[121], self.rpm(self[128]), self.rpm(1000))
        else:
            super()._inputs_2(before, now)


def test_an_absolute_target_taken_for_a_relative_one_is_stopped() -> None:
    text, way_mm = judged("aasd_15a", maker=Absolute)
    assert "kind of target (absolute, relative) is wrong" in text
    assert way_mm < CAUGHT_WITHIN_MM


@pytest.mark.parametrize("name", FAMILIES)
def test_a_fault_is_shown_and_reset_without_power(name: str) -> None:
    with family(name) as rig, rig.drive.proving(), rig.drive:
        rig.drive.enable()
        rig.maker.servo.raise_fault(0x21)
        assert rig.drive.sample().state is DriveState.FAULT
        rig.drive.reset_fault()
        assert rig.drive.sample().state is not DriveState.FAULT
        assert not rig.maker.servo.fault_code
        assert not rig.maker.servo.powered


# -- wrong maps --------------------------------------------------------------------------------------------------------
def changed(name: str, tmp_path: Path, change: Callable[[str], str]) -> Path:
    text = find_map(name).read_text(encoding="utf-8")
    wrong = change(text)
    assert wrong != text
    path = tmp_path / f"{name}.toml"
    path.write_text(wrong, encoding="utf-8")
    return path


def of_speed(name: str, change: Callable[[str], str]) -> Callable[[str], str]:
    """Change the line of the register of a move's velocity."""
    register = load_drive_map(name).move.velocity
    return lambda text: re.sub(rf"(?m)^{register} = .*$", lambda line: change(line[0]), text)


def speed_as_counts(line: str) -> str:
    line = re.sub(r"scale = [\d.e-]+, |, scale = [\d.e-]+|limits = \[[^]]*\], |, limits = \[[^]]*\]", "", line)
    if "counts/s" in line:  # AZ has Hz; the mistake there is r/min
        return line.replace('unit = "counts/s"', 'unit = "rpm"')
    return re.sub(r'unit = "[^"]*"', 'unit = "counts/s"', line)


def ten_times(line: str) -> str:
    scale = re.search(r"scale = ([\d.e-]+)", line)
    line = re.sub(r"limits = \[[^]]*\], |, limits = \[[^]]*\]", "", line)
    if scale:
        return line.replace(scale[0], f"scale = {10 * float(scale[1])!r}")
    return line.replace("unit =", "scale = 0.1, unit =")


def swapped(text: str) -> str:
    words = {"big": "little", "little": "big"}
    return re.sub(r'word_order = "(\w+)"', lambda found: f'word_order = "{words[found[1]]}"', text)


def judged(name: str, **how: object) -> tuple[str, float]:
    with examined(name, **how) as (rig, session):
        text = failures(doctor(session))
        return text, travelled_mm(rig)


@pytest.mark.parametrize("name", each_family())
def test_revolutions_per_minute_taken_for_counts_are_caught(name: str, tmp_path: Path) -> None:
    text, way_mm = judged(name, map_path=changed(name, tmp_path, of_speed(name, speed_as_counts)))
    assert "unit of velocity" in text or "too fast" in text or "not over within" in text, text
    assert way_mm < CAUGHT_WITHIN_MM


@pytest.mark.parametrize("name", each_family())
def test_a_speed_wrong_by_ten_is_caught(name: str, tmp_path: Path) -> None:
    text, way_mm = judged(name, map_path=changed(name, tmp_path, of_speed(name, ten_times)))
    assert "speed" in text, text
    assert way_mm < CAUGHT_WITHIN_MM


@pytest.mark.parametrize(("name", "factor"), each_family(3 * (0.1, 0.25, 4, 13.1072)))
def test_wrong_counts_per_turn_are_caught(name: str, factor: float) -> None:
    counts, feed_mm = round(FAMILIES[name].counts_per_rev * factor), FEED_MM
    if load_drive_map(name).registers[load_drive_map(name).position].unit == "rev":  # counts do not matter there
        counts, feed_mm = FAMILIES[name].counts_per_rev, FEED_MM / factor
    text, way_mm = judged(name, scaling=AxisScaling(counts, feed_mm))
    assert text
    assert way_mm < CAUGHT_WITHIN_MM


@pytest.mark.parametrize("name", each_family())
def test_a_wrong_word_order_is_caught_before_anything_moves(name: str, tmp_path: Path) -> None:
    text, way_mm = judged(name, map_path=changed(name, tmp_path, swapped))
    assert "word order looks wrong" in text, text
    assert way_mm == 0.0


@pytest.mark.parametrize("name", each_family())
def test_a_turned_direction_is_caught(name: str) -> None:
    text, way_mm = judged(name, scaling=AxisScaling(FAMILIES[name].counts_per_rev, FEED_MM, direction=-1))
    assert "direction is reversed" in text, text
    assert way_mm < CAUGHT_WITHIN_MM


@pytest.mark.parametrize("name", each_family())
def test_a_wrong_word_order_is_caught_where_the_axis_stands_at_zero(name: str, tmp_path: Path) -> None:
    """0 reads alike in both orders: other registers tell it, or the axis is not moved, or the fence stops it."""
    at_zero = type("AtZero", (FAMILIES[name],), {"start_counts": 0})
    text, way_mm = judged(name, map_path=changed(name, tmp_path, swapped), maker=at_zero)
    assert text
    assert way_mm < CAUGHT_WITHIN_MM


class NothingKnown(AppliedMotion):
    start_counts = 0

    def table(self) -> None:
        super().table()
        for address in (344, 346, 348, 350):
            self.rows[address].value = 0


def test_an_axis_whose_word_order_nothing_tells_is_not_moved() -> None:
    text, way_mm = judged("applied_motion", maker=NothingKnown)
    assert "word order: no value found tells the word order" in text
    assert "turn the motor some turns by hand" in text
    assert way_mm == 0.0


def test_a_relative_target_taken_for_an_absolute_one_is_stopped(tmp_path: Path) -> None:
    path = changed("delta_asda_a2", tmp_path, lambda text: text.replace("value = 2", "value = 0x42"))
    text, way_mm = judged("delta_asda_a2", map_path=path)
    assert "kind of target (absolute, relative) is wrong" in text
    assert 0.1 < way_mm < CAUGHT_WITHIN_MM


class StopsLater(LeadshineEl7):
    """Its order 0x40 is another one than the notes say."""

    def _trigger(self, before: int, order: int) -> None:
        if order == 0x40:
            self._order = order
            self.after(1.0, lambda: self.servo.quick_stop(self.ramp(20)))
        else:
            super()._trigger(before, order)


def test_a_quick_stop_that_does_not_stop_is_found_out(tmp_path: Path) -> None:
    with examined("leadshine_el7", maker=StopsLater) as (rig, session):
        rig.drive._ledger = FactLedger(tmp_path / "facts.json", "here", find_map("leadshine_el7"))
        checks = doctor(session)
        assert failures(checks).startswith("quick stop: ")
        assert "stop" in rig.drive.unproven()
        with pytest.raises(StateError, match="not proven on this drive"):
            rig.drive.enable()


# -- on a serial line ----------------------------------------------------------------------------------------------
SERIAL_ONLY = ("leadshine_el7", "lichuan_a6", "stepperonline_a6_rs", "aasd_15a")


@pytest.mark.outside
@pytest.mark.parametrize("name", SERIAL_ONLY)
def test_a_family_does_on_a_line_what_it_does_over_tcp(name: str) -> None:
    result = exercise(name, "umodbus")
    assert abs(result.speed_percent) < 1.0
    assert abs(result.distance_mm) < 0.002
    assert abs(result.stop_mm) < 3.0
    assert result.changed == ()
    assert result.homing == "yes"


@pytest.mark.outside
def test_a_scan_and_a_first_axis_file_over_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    baud = str(load_drive_map("lichuan_a6").registers.bus.baud)
    maker = LichuanA6(SimClock())
    with served_on_a_line(maker, int(baud)) as (port, server):
        line = f"{port}?parity=N"  # a pseudo-terminal refuses the parity that the drive has
        where = ["--serial", line, "--baud", baud]
        assert main(["scan", *where, "--units", "1-3", "--map", "lichuan_a6"]) == 0
        said = capsys.readouterr().out
        assert f'hil drives new X.toml --drive lichuan_a6 --serial "{line}" --baud {baud} --unit 1' in said
        path = tmp_path / "X.toml"
        known = [f"--travel={LIMITS.travel_min_mm:g},{LIMITS.travel_max_mm:g}", "--max-velocity", "200"]
        known += ["--max-acceleration", "2000", "--feed", f"{FEED_MM:g}", "--instrument-port", "/dev/null"]
        assert main(["drives", "new", str(path), "--drive", "lichuan_a6", "--serial", line, *known]) == 0
        assert server.requests > 3
        assert maker.memory() == maker.found
    axis = load_axis(path)
    endpoint = modbus_endpoint(axis)
    assert (endpoint.baud, endpoint.parity) == (int(baud), "N")  # type: ignore[union-attr]
    assert axis.scaling.encoder_counts_per_motor_rev == FAMILIES["lichuan_a6"].counts_per_rev
