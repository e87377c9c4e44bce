"""M90 to M93 on virtual drives: what moves, where it stops, and how the machine is left whatever happens."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from support import probe_files
from support.probe_files import connected_probe

from drivers.drive import Capability
from drivers.errors import CapabilityError, DriveFaultError, InputError, LimitError, StateError
from hil.machine.events import Event
from hil.probe.machine_file import ProbeMachineConfig, load_probe_machine
from hil.probe.procedure import centre_bore, correct, measure_and_store, measure_run_out, on_schedule
from hil.probe.runout import CorrectionCode, RunOut
from hil.probe.session import NoContactError, ProbeSession, UnexpectedContactError
from hil.probe.store import RunOutStore
from hil.probe.wiring import probe_bench, probe_drives, probe_session
from sim_backends.clock import SimClock
from sim_backends.plant.touch_probe import Chip, Face, Stylus
from sim_backends.probe import ProbeParameters
from sim_backends.probe_bench import ProbeBench
from sim_backends.virtual_drive import VirtualDrive

STYLUS = Stylus(2.0, (0.030, -0.012))
FAULT = 0x3210


def load(tmp_path: Path, **more: object) -> ProbeMachineConfig:
    given = {"start_mm": 102.7, "search_mm": 0.6, "block": "turns = 1", **more}
    return load_probe_machine(probe_files.lay_out(tmp_path, **given))  # type: ignore[arg-type]


def truth(face_mm: float = 105.0, **more: object) -> ProbeParameters:
    return ProbeParameters(STYLUS, (Face((face_mm, 40.0, 0.0)),), **more)  # type: ignore[arg-type]


def left_as_found(bench: ProbeBench) -> bool:
    """Every servo at rest without power, no latch armed, and no ball pushed too far."""
    servos = bench.servos.values()
    at_rest = all(not servo.powered and not servo.velocity_actual_counts_s for servo in servos)
    return at_rest and bench.probe.deepest_mm < 0.2


@contextmanager
def rig(
    config: ProbeMachineConfig, bench: ProbeBench, **more: object
) -> Iterator[tuple[ProbeSession, dict[str, VirtualDrive]]]:
    """A session with its virtual drives in reach."""
    with probe_drives(config, bench) as drives:
        with probe_session(config, drives, **more) as session:  # type: ignore[arg-type]
            yield session, drives  # type: ignore[misc]
        assert not any(channel.enabled for drive in drives.values() for channel in drive.probe.channels)  # type: ignore[attr-defined]


# -- M90 -----------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("mode", ["latch", "step"])
def test_run_out_and_radius_come_out_and_the_machine_is_where_it_was(tmp_path: Path, mode: str) -> None:
    config = load(tmp_path, start_mm=102.93, search_mm=0.3)
    bench = probe_bench(config, truth())
    places = {name: bench.place(name) for name in config.axes}
    with rig(config, bench, mode=mode) as (session, _):
        measured = measure_run_out(session)
    found = measured.run_out
    assert (found.x_mm, found.y_mm, found.tip_radius_mm) == pytest.approx((0.030, -0.012, 2.0), abs=0.6e-3)
    assert measured.refusal(config) is None
    assert measured.mode == mode
    assert {name: bench.place(name) for name in config.axes} == pytest.approx(places, abs=1e-4)
    assert left_as_found(bench)
    assert bench.probe.touches == 4


@pytest.mark.parametrize("mode", ["latch", "step"])
def test_a_probe_that_opens_its_contact(tmp_path: Path, mode: str) -> None:
    config = load(tmp_path, start_mm=102.95, search_mm=0.3, probe="normally_closed = true")
    bench = probe_bench(config, truth())
    with rig(config, bench, mode=mode) as (session, drives):
        assert drives["x"].probe.inputs & 1
        found = measure_run_out(session).run_out
    assert (found.x_mm, found.y_mm, found.tip_radius_mm) == pytest.approx((0.030, -0.012, 2.0), abs=0.6e-3)
    mistaken = load(tmp_path)
    bench = probe_bench(config, truth())
    with probe_drives(config, bench) as drives, pytest.raises(StateError, match="signals before anything has moved"):
        probe_session(mistaken, drives).__enter__()


def test_stepping_feeds_one_pulse_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load(tmp_path, start_mm=102.94, search_mm=0.3)
    targets: list[float] = []
    start_move = VirtualDrive.start_move

    def noting(drive: VirtualDrive, position_load_mm: float, velocity_mm_s: float) -> None:
        if drive.name == "X":
            targets.append(position_load_mm)
        start_move(drive, position_load_mm, velocity_mm_s)

    monkeypatch.setattr(VirtualDrive, "start_move", noting)
    with connected_probe(config, bench=probe_bench(config, truth()), mode="step") as session:
        measured = measure_run_out(session)
    pulses = [b - a for a, b in itertools.pairwise(targets) if b > a]
    assert pulses == pytest.approx([0.001] * len(pulses), abs=1e-9)
    # 60 µm less the run-out towards the face: 30, 12, −30, −12 µm; the middle of the last pulse is given
    assert [round(1000 * feed, 3) for feed in vars(measured.feeds).values()] == [29.5, 47.5, 89.5, 71.5]
    assert len(pulses) == 30 + 48 + 90 + 72


def test_what_is_refused_is_in_the_history_and_not_in_force(tmp_path: Path) -> None:
    config = load(tmp_path)
    store = RunOutStore(tmp_path / "store", "mill")
    when = datetime(2026, 1, 1, tzinfo=UTC)
    with connected_probe(config, bench=probe_bench(config, truth())) as session:
        assert measure_and_store(session, store, lambda: when)[1] is None
    before = store.load()
    with connected_probe(config, bench=probe_bench(config, truth(chips=(Chip(0.05, 1, 1),)))) as session:
        _, refusal = measure_and_store(session, store, lambda: when)
    assert refusal is not None
    assert "N0 + N180 = 0.6000 mm, N90 + N270 = 0.5500 mm, +50.0 µm" in refusal
    assert store.load() == before
    assert [row["verdict"][:7] for row in store.history()] == ["stored", "refused"]


def test_a_loose_tool_does_not_close(tmp_path: Path) -> None:
    config = load(tmp_path)
    with connected_probe(config, bench=probe_bench(config, truth(play_mm=0.05))) as session:
        refusal = measure_run_out(session).refusal(config)
    assert refusal is not None
    assert "do not close" in refusal


# -- what goes wrong -------------------------------------------------------------------------------------------------------
def test_a_contact_on_the_way_stops_the_machine(tmp_path: Path) -> None:
    """Something stands 2 mm before the place where measuring is to start."""
    config = load(tmp_path)
    bench = probe_bench(replace(config, block=replace(config.block, start_mm=95.0)), truth(face_mm=102.0))
    with (
        pytest.raises(UnexpectedContactError, match=r"touched at X = 99\.9\d\d mm|touched at X = 100\.\d+ mm"),
        rig(config, bench) as (session, _),
    ):
        measure_run_out(session)
    assert left_as_found(bench)
    assert bench.place("x") < 100.2


def test_no_contact_within_the_stated_travel(tmp_path: Path) -> None:
    for mode in ("latch", "step"):
        config = load(tmp_path, search_mm=0.05)
        bench = probe_bench(config, truth(face_mm=110.0))
        with (
            pytest.raises(NoContactError, match=r"no contact within 0\.05 mm of X, which stands at 102\.750 mm"),
            rig(config, bench, mode=mode) as (session, _),
        ):
            measure_run_out(session)
        assert left_as_found(bench)


def test_a_contact_too_soon(tmp_path: Path) -> None:
    config = load(tmp_path, block="turns = 1\nfree_mm = 0.4")
    bench = probe_bench(config, truth())
    with (
        pytest.raises(UnexpectedContactError, match=r"after 0\.27\d\d mm of X, expected 0\.4 mm free"),
        rig(config, bench) as (s, _),
    ):
        measure_run_out(s)
    assert left_as_found(bench)


def test_a_probe_that_signals_from_the_start_moves_nothing(tmp_path: Path) -> None:
    config = load(tmp_path)
    bench = probe_bench(config, truth(face_mm=104.0))
    with pytest.raises(StateError, match="signals before anything has moved"), rig(config, bench):
        pass
    assert bench.clock.now_ns() == 0


class _Stuck:
    """A signal that does not go away once it has come."""

    def __init__(self, drive: VirtualDrive) -> None:
        self.drive = drive
        self.seen = False

    def touching(self) -> bool:
        self.seen = self.seen or bool(self.drive.probe.inputs & 1)
        return self.seen


def test_a_probe_that_does_not_release_stops_the_way_back(tmp_path: Path) -> None:
    config = load(tmp_path, probe="overtravel_mm = 0.1")
    bench = probe_bench(config, truth())
    with probe_drives(config, bench) as drives:
        signals = {"x": _Stuck(drives["x"])}  # type: ignore[arg-type]
        with (
            pytest.raises(UnexpectedContactError, match="the way back"),
            ProbeSession(config, drives, signals) as session,
        ):
            measure_run_out(session)
    assert left_as_found(bench)
    assert bench.place("x") > config.block.start_mm + 0.05


def test_a_signal_without_a_latch_is_an_input_wired_elsewhere(tmp_path: Path) -> None:
    config = load(tmp_path, probe="overtravel_mm = 0.1")
    bench = probe_bench(config, truth())
    with probe_drives(config, bench) as drives:
        session = probe_session(config, drives)
        drives["x"].probe.attach(1, lambda _counts: False)  # type: ignore[attr-defined]
        drives["x"].probe.channels[0].contact = None  # type: ignore[attr-defined]
        session.config = replace(config, probe=replace(config.probe, input=2))
        with pytest.raises(UnexpectedContactError, match="touching with X"), session:
            measure_run_out(session)
    assert left_as_found(bench)


def test_a_drive_that_latches_nothing_is_said_before_moving_and_may_step(tmp_path: Path) -> None:
    config = load(tmp_path, start_mm=102.95)
    bench = probe_bench(config, truth())
    with probe_drives(config, bench) as drives:
        x = drives["x"]
        assert isinstance(x, VirtualDrive)
        x.settings = replace(x.settings, missing=frozenset({Capability.TOUCH_PROBE}))
        with pytest.raises(
            CapabilityError, match="drive X cannot do: touch probe; nothing was moved, expected mode step"
        ):
            probe_session(config, drives).__enter__()
        assert bench.clock.now_ns() == 0
        with probe_session(config, drives, mode="step") as session:
            assert measure_run_out(session).refusal(config) is None


@pytest.mark.parametrize("mode", ["latch", "step"])
def test_a_fault_while_touching_stops_the_others_too(tmp_path: Path, mode: str) -> None:
    config = load(tmp_path)
    bench = probe_bench(config, truth())
    faults = iter([FAULT])

    def failing(now_ns: int, _dt_s: float) -> None:
        if bench.servos["x"].velocity_actual_counts_s and now_ns > 1_500_000_000:
            for code in faults:
                bench.servos["x"].raise_fault(code)

    bench.clock.attach(failing)
    with (
        pytest.raises(DriveFaultError, match=r"drive X went into fault during .*: error code 3210h"),
        rig(config, bench, mode=mode) as (session, _),
    ):
        measure_run_out(session)
    assert next(faults, None) is None
    bench.clock.sleep_s(0.1)  # it brakes by itself
    assert left_as_found(bench)


def test_an_axis_that_is_not_homed_is_refused_or_homed(tmp_path: Path) -> None:
    config = load(tmp_path)
    bench = probe_bench(config, truth())
    bench.servos["y"].homed = False
    with pytest.raises(StateError, match="drive Y is not homed"), rig(config, bench):
        pass
    assert bench.clock.now_ns() == 0
    path = config.path
    path.write_text(path.read_text().replace('name = "mill"', 'name = "mill"\nhome = true'))
    with rig(load_probe_machine(path), bench) as (session, _):
        assert measure_run_out(session).refusal(config) is None
    assert bench.servos["y"].homed
    assert bench.place("y") == pytest.approx(0.0, abs=0.01)  # where homing ended, which is where measuring found it


@pytest.mark.parametrize("error", [KeyboardInterrupt(), InputError("listener")])
def test_an_interrupt_at_any_step_stops_and_restores(tmp_path: Path, error: BaseException) -> None:
    config = load(tmp_path)
    for step in (0, 2, 4):
        bench = probe_bench(config, truth())

        def interrupting(event: Event, step: int = step) -> None:
            if event.done == step:
                raise error

        with pytest.raises(type(error)), rig(config, bench) as (session, _):
            measure_run_out(session, interrupting)
        assert left_as_found(bench)


def test_turns_that_were_over_when_it_was_broken_off_are_in_the_history(tmp_path: Path) -> None:
    config = load(tmp_path, block="turns = 3")
    store = RunOutStore(tmp_path / "store", "mill")
    bench = probe_bench(config, truth())

    def interrupting(event: Event) -> None:
        if event.done == 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), rig(config, bench) as (session, _):
        measure_and_store(session, store, lambda: datetime(2026, 1, 1, tzinfo=UTC), interrupting)
    (row,) = store.history()
    assert row["verdict"] == "broken off: KeyboardInterrupt"
    assert float(row["x_um"]) == pytest.approx(30.0, abs=0.1)
    assert not store.path.exists()


# -- corrections -----------------------------------------------------------------------------------------------------------
KNOWN = RunOut(0.030, -0.012, 2.0)


@pytest.mark.parametrize(
    ("code", "angle_deg", "moved_um"),
    [
        (CorrectionCode.M91, 0.0, (30.0, 0.0)),
        (CorrectionCode.M92, 0.0, (0.0, -12.0)),
        (CorrectionCode.M93, 0.0, (30.0, -12.0)),
        (CorrectionCode.M93, 90.0, (12.0, 30.0)),
    ],
)
def test_a_correction_drives_the_axis_and_its_counter_ends_at_zero(
    tmp_path: Path, code: CorrectionCode, angle_deg: float, moved_um: tuple[float, float]
) -> None:
    config = load(tmp_path)
    bench = probe_bench(config, truth(), in_bore=True)
    with connected_probe(config, touching=("x", "y"), bench=bench) as session:
        session.prepare()
        session.orient(angle_deg)
        done = correct(session, KNOWN, code)
    assert (1000 * (bench.place("x") - 50.0), 1000 * (bench.place("y") - 60.0)) == pytest.approx(moved_um, abs=0.05)
    assert done.counter_mm == pytest.approx((0.0, 0.0), abs=1e-4)
    assert [1000 * driven for driven in done.driven_mm] == pytest.approx(moved_um, abs=0.02)


def test_a_correction_out_of_the_limits_moves_nothing(tmp_path: Path) -> None:
    config = load(tmp_path)
    bench = probe_bench(config, truth(), in_bore=True)
    with connected_probe(config, touching=("x", "y"), bench=bench) as session:
        before = bench.place("x")
        with pytest.raises(LimitError):
            correct(session, RunOut(0.03, 500.0, 2.0), CorrectionCode.M93)
        assert bench.place("x") == before


def test_a_probe_outside_the_bore_is_not_driven_into_it(tmp_path: Path) -> None:
    config = load(tmp_path)
    bench = probe_bench(config, truth())
    with (
        connected_probe(config, touching=("x", "y"), bench=bench) as session,
        pytest.raises(StateError, match=r"x is at 102\.700 mm, expected the probe in the bore, within 8 mm of 50 mm"),
    ):
        centre_bore(session, KNOWN, CorrectionCode.M93)
    assert bench.place("x") == pytest.approx(102.7)


# -- schedule --------------------------------------------------------------------------------------------------------------
def test_a_schedule_keeps_its_times_and_leaves_missed_turns_out() -> None:
    clock = SimClock(step_s=100.0)
    begun: list[float] = []
    lasting = iter([10.0, 10.0, 4000.0, 10.0, 10.0])
    heard: list[Event] = []

    def job() -> str | None:
        begun.append(clock.now_ns() / 1e9)
        clock.sleep_s(next(lasting))
        return "a chip" if len(begun) == 2 else None

    result = on_schedule(job, clock, 1800.0, 5, heard.append)
    assert begun == pytest.approx([0.0, 1800.0, 3600.0, 9000.0, 10800.0])  # the one at 7200 + 200 s is not made up for
    assert (result.done, result.refused) == (5, 1)
    assert sum("refused: a chip" in event.message for event in heard) == 1
    assert clock.now_ns() / 1e9 == pytest.approx(10810.0)


def test_an_error_ends_a_schedule() -> None:
    done: list[int] = []

    def job() -> str | None:
        done.append(1)
        if len(done) == 2:
            raise NoContactError("stopped")
        return None

    with pytest.raises(NoContactError):
        on_schedule(job, SimClock(step_s=100.0), 60.0)
    assert len(done) == 2
