"""A lost signal in the middle of a pass: waited for only where that is allowed, and what comes afterwards is as good as before."""

# ruff: noqa: PT012 - leaving the session is part of what raises, so whole sessions stand under raises()
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.bench_axis import lay_out
from support.toy_axis import ToyInstrument, ToyMachine, toy_session

from drivers.clock import NS_PER_S
from drivers.drive import DriveState
from drivers.errors import DriveFaultError, LinkLostError, MeasurementLostError, StateError
from drivers.instrument import Reading, ReadingStatus
from hil.axis.axis_file import load_axis
from hil.machine.bench_wiring import bench_parameters, running_bench
from hil.machine.events import Event
from hil.machine.measure import MOST_LOSSES, STEADY_S, Step, bidirectional_steps, measure
from hil.machine.session import AxisSession
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from hil.records.rows import Records
from sim_backends.canopen_drive import CanOpenSlave
from sim_backends.canopen_in_turn import DrivesInTurn
from sim_backends.faults import CanFaultKind, Fault, FaultKind

TARGETS = (0.0, 30.0, 61.0, 100.0)


class Outage:
    """The signal is away between two moments of simulated time, and the instrument's zero is another one afterwards."""

    def __init__(self, instrument: ToyInstrument, *windows: tuple[float, float], port: bool = False) -> None:
        self.windows, self.port = windows, port
        self.lost = False  # latched until acknowledged, as a counting instrument is
        self.machine = instrument.machine
        self.plain = instrument.poll
        instrument.poll = self.poll  # type: ignore[method-assign]
        instrument.acknowledge_loss = self.acknowledge  # type: ignore[method-assign]

    def acknowledge(self) -> None:
        self.lost = False

    def poll(self) -> Sequence[Reading]:
        if self.port and self.is_away(self.machine.now_s):
            self.lost = True
            raise LinkLostError("port toy is gone")
        return [self.as_heard(reading) for reading in self.plain()]

    def is_away(self, time_s: float) -> bool:
        return any(start <= time_s < end for start, end in self.windows)

    def as_heard(self, reading: Reading) -> Reading:
        time_s = reading.time_ns / NS_PER_S
        self.lost |= self.is_away(time_s)
        if self.lost:
            return replace(reading, status=ReadingStatus.BEAM_LOST, position_mm=None)
        gone = sum(end <= time_s for _, end in self.windows)
        return replace(reading, position_mm=(reading.position_mm or 0.0) + 7.25 * gone)


def outage(session: AxisSession, *windows: tuple[float, float], port: bool = False) -> None:
    assert isinstance(session.instrument, ToyInstrument)
    Outage(session.instrument, *windows, port=port)


def passed(directory: Path, session: AxisSession, events: list[Event]) -> Records:
    session.prepare()
    campaign = Campaign(directory, {"kind": "test"}, resume=False)
    return measure(session, campaign, "pass", bidirectional_steps(TARGETS, 1), events.append)


def undisturbed(directory: Path) -> tuple[Records, float]:
    machine = ToyMachine()
    with toy_session(machine) as session:
        return passed(directory, session, []), machine.now_s


@pytest.mark.parametrize("port", [False, True], ids=["beam", "port"])
def test_every_moment_of_a_pass_may_lose_the_signal(tmp_path: Path, port: bool) -> None:
    plain, end_s = undisturbed(tmp_path / "plain")
    for number, at_s in enumerate(np.linspace(5.0, end_s - 0.5, 4)):
        machine, events = ToyMachine(), list[Event]()
        with toy_session(machine) as session:
            session.resume_within_s = 60.0
            outage(session, (at_s, at_s + 5.0), port=port)
            records = passed(tmp_path / str(number), session, events)
        assert np.array_equal(records.target_mm, plain.target_mm)
        assert records.error_um == pytest.approx(plain.error_um, abs=1e-6)
        notes = [
            line for line in (tmp_path / str(number) / "pass.csv").read_text().splitlines() if line.startswith("#")
        ]
        assert len(notes) == 4
        assert "waiting up to 60 s" in notes[1]
        assert "datum taken anew" in notes[2]
        assert "8 averages of 10 or more readings: standard deviation of a reading" in notes[3]
        assert [event.message for event in events if event.message in notes[2]] != []
        assert len(machine.told("quick stop")) >= 1
        assert len(machine.told("enable")) == 2


def test_rows_that_go_on_from_the_one_before_are_the_same_after_a_pause(tmp_path: Path) -> None:
    """Short strokes of a nut with play: what a row holds is the travel behind it, which taking the datum anew took away."""
    there = [Step(1, 1, target, 0.0) for target in (50.01, 50.03, 50.06, 54.0)]
    back = [Step(1, -1, target, 0.0) for target in (53.99, 53.97, 53.94, 50.0)]
    steps = [Step(1, -1, 50.0, 1.0), *there, *back, *there]

    def rows(path: Path, *window: float) -> np.ndarray:
        with toy_session(ToyMachine(play_mm=0.05, wave_um=0.0)) as session:
            if window:
                session.resume_within_s = 60.0
                outage(session, (window[0], window[0] + 5.0))
            session.prepare()
            records = measure(session, Campaign(path, {"kind": "test"}, resume=False), "pass", steps)
            return np.append(records.error_um, session.elapsed_s())

    plain = rows(tmp_path / "plain")
    assert len(set(plain[:-1].round(1).tolist())) > 4
    for number, at_s in enumerate(np.linspace(4.0, plain[-1] - 0.3, 12)):
        disturbed = rows(tmp_path / str(number), float(at_s))
        assert disturbed[-1] > plain[-1]
        assert disturbed[:-1] == pytest.approx(plain[:-1], abs=1e-6), f"lost at {at_s:.1f} s"


def test_nothing_moves_before_the_signal_was_steady(tmp_path: Path) -> None:
    machine = ToyMachine()
    moves: list[float] = []
    with toy_session(machine) as session:
        session.resume_within_s = 60.0
        outage(session, (6.0, 10.0), (10.5, 13.0))
        start = session.drive.start_move

        def start_move(position_mm: float, velocity_mm_s: float) -> None:
            moves.append(machine.now_s)
            start(position_mm, velocity_mm_s)

        session.drive.start_move = start_move  # type: ignore[method-assign]
        passed(tmp_path / "c", session, [])
    assert not [at for at in moves if 6.1 < at < 13.0 + STEADY_S], "half a second of signal is none"
    assert [at for at in moves if 13.0 + STEADY_S <= at < 13.0 + 2 * STEADY_S]


def test_without_leave_the_job_ends(tmp_path: Path) -> None:
    machine = ToyMachine()
    with pytest.raises(MeasurementLostError, match="beam lost"), toy_session(machine) as session:
        outage(session, (6.0, 10.0))
        passed(tmp_path / "c", session, [])
    assert machine.state is DriveState.SWITCH_ON_DISABLED


def test_a_signal_that_does_not_come_back_ends_the_job_in_time(tmp_path: Path) -> None:
    machine = ToyMachine()
    with pytest.raises(MeasurementLostError, match="beam lost"), toy_session(machine) as session:
        session.resume_within_s = 20.0
        outage(session, (6.0, math.inf))
        passed(tmp_path / "c", session, [])
    assert 26.0 <= machine.now_s < 28.0
    assert (tmp_path / "c" / "pass.csv").read_text().count("# instrument") == 1


@pytest.mark.parametrize(("losses", "ends"), [(MOST_LOSSES - 1, False), (MOST_LOSSES, True)])
def test_a_point_that_loses_the_signal_again_and_again_is_given_up(tmp_path: Path, losses: int, ends: bool) -> None:
    """Each time it comes back, at the datum, and is cut off on the way to the same place: a cover of the machine."""
    machine, told, rows = ToyMachine(), list[Event](), []
    with toy_session(machine) as session:
        session.resume_within_s = 60.0
        session.prepare()
        read = session.read_position

        def cut_off(*args: object, **kwargs: object) -> object:
            if len(rows) < losses:
                rows.append(machine.now_s)
                session.drive.quick_stop()
                raise MeasurementLostError("beam lost")
            return read(*args, **kwargs)  # type: ignore[arg-type]

        session.read_position = cut_off  # type: ignore[assignment,method-assign]
        campaign = Campaign(tmp_path / "c", {"kind": "test"}, resume=False)
        if ends:
            with pytest.raises(MeasurementLostError, match=f"lost {MOST_LOSSES} times on the way to the same point"):
                measure(session, campaign, "pass", bidirectional_steps(TARGETS, 1), told.append)
        else:
            assert len(measure(session, campaign, "pass", bidirectional_steps(TARGETS, 1), told.append)) == 8
    assert len(rows) == losses


def test_a_fault_of_the_drive_is_not_waited_for(tmp_path: Path) -> None:
    machine = ToyMachine()
    machine.trouble.fault_at_s = 8.0
    with pytest.raises(DriveFaultError), toy_session(machine) as session:
        session.resume_within_s = 60.0
        outage(session, (6.0, 10.0))
        passed(tmp_path / "c", session, [])
    assert machine.now_s < 9.0


def test_over_the_wire_the_beam_is_lost_and_the_rows_are_still_the_truth(tmp_path: Path) -> None:
    path = lay_out(tmp_path, machine="geometric", sections=4, runs=1)
    text = path.read_text().replace("place_temps", "resume_within_s = 30\nplace_temps")
    path.write_text(text.replace('backend = "bench"', 'backend = "bench"\nface = "virtual"'))
    axis = load_axis(path)
    faults = (Fault(FaultKind.BEAM_LOST, at_s=11.0, duration_s=4.0),)
    true_mm: list[float] = []
    wanted = replace(bench_parameters(axis), laser_faults=faults)
    with running_bench([axis], [wanted]) as running, connected(axis, running) as machine:
        bench = machine.bench
        assert bench is not None

        def hear(event: Event) -> None:
            if event.message.endswith(" mm"):
                true_mm.append(bench.plant.position_mm)

        machine.session.prepare()
        assert machine.session.elapsed_s() < 10.0
        campaign = Campaign.numbered(axis.store.directory, axis.purpose("verify"), resume=False)
        records = measure(
            machine.session, campaign, "verify", bidirectional_steps(axis.measurement.targets_mm, 1), hear
        )
    assert "beam lost; waiting" in (campaign.directory / "verify.csv").read_text()
    off_um = (records.measured_mm - np.array(true_mm)) * 1000.0
    assert len(off_um) == 8
    assert np.ptp(off_um) < 0.3


@pytest.mark.parametrize("ending", [2, 6], ids=["powers off after a quick stop", "holds after a quick stop"])
@pytest.mark.parametrize("switched_off", [False, True])
def test_a_drive_that_was_switched_off_meanwhile_is_not_enabled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: int, switched_off: bool
) -> None:
    """Safe torque off for a second, without a fault, while the beam is away: somebody opened the door. CiA 402: bit 4 of the
    statusword, and no state above switch on disabled."""
    path = lay_out(tmp_path, sections=4, runs=1)
    path.write_text(path.read_text().replace("place_temps", "resume_within_s = 30\nplace_temps"))
    axis = load_axis(path)
    slaves, add = list[CanOpenSlave](), DrivesInTurn.add

    def put(*args: object, **kwargs: object) -> CanOpenSlave:
        slaves.append(add(*args, **kwargs))  # type: ignore[arg-type]
        return slaves[-1]

    monkeypatch.setattr(DrivesInTurn, "add", put)
    loss = Fault(FaultKind.BEAM_LOST, at_s=11.0, duration_s=4.0)
    wanted = replace(bench_parameters(axis), laser_faults=(loss,))
    with running_bench([axis], [wanted]) as running, connected(axis, running) as machine:
        profile, session = slaves[0].profile, machine.session
        slaves[0].dictionary.set_number(0x605A, 0, ending)
        started_ns, states = session.clock.now_ns(), list[DriveState]()

        def door(now_ns: int, _dt_s: float) -> None:
            now_s = (now_ns - started_ns) / NS_PER_S
            if switched_off and 13.0 <= now_s < 14.0:
                profile.defects.add(CanFaultKind.SAFE_TORQUE_OFF)
            else:
                profile.defects.discard(CanFaultKind.SAFE_TORQUE_OFF)
            if now_s > 14.0:
                states.append(profile.state)

        machine.bench.clock.attach(door)
        session.prepare()
        steps = bidirectional_steps(axis.measurement.targets_mm, 1)
        campaign = Campaign.numbered(axis.store.directory, axis.purpose("verify"), resume=False)
        if switched_off:
            with pytest.raises(StateError, match="somebody may be in the machine"):
                measure(session, campaign, "verify", steps)
            assert DriveState.ENABLED not in states
        else:
            assert len(measure(session, campaign, "verify", steps)) == len(steps)


@pytest.mark.parametrize("face", ["virtual", "canopen", "modbus-rtu"])
def test_a_script_acknowledges_a_loss_and_prepares_anew(face: str, tmp_path: Path) -> None:
    """The error names what it has to call; without it no motion begins, with it the datum is where it was."""
    path = lay_out(tmp_path, sections=4)
    text = path.read_text(encoding="utf-8").replace("[drive]\n", f'[drive]\nface = "{face}"\n')
    path.write_text(text, encoding="utf-8")
    axis = load_axis(path)
    loss = Fault(FaultKind.BEAM_LOST, at_s=45.0, duration_s=0.5)
    wanted = replace(bench_parameters(axis), laser_faults=(loss,))
    with running_bench([axis], [wanted]) as running, connected(axis, running) as machine:
        session = machine.session
        session.prepare()
        with pytest.raises(MeasurementLostError, match="beam lost"):
            session.watch(60.0)
        session.clock.sleep_s(0.6)
        before_mm = session.drive.sample().position_load_mm
        with pytest.raises(MeasurementLostError, match=r"acknowledge_loss\(\)"):
            session.prepare()
        assert session.drive.sample().state is not DriveState.ENABLED
        assert session.drive.sample().position_load_mm == pytest.approx(before_mm, abs=0.001)
        session.acknowledge_loss()
        session.prepare()
        assert session.read_position().position_load_mm == pytest.approx(axis.measurement.reference_mm, abs=0.05)
