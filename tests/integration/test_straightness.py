"""Straightness from the optics to the other axis: measured, proven, stored and in force, by the commands a user types.

The judge is the simulated machine's own guideway (`sim_backends.plant`), which shares no code with what corrects it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest
from support.two_axes import lay_out_bent

from drivers.drive import DriveState
from drivers.errors import BridgeError, DriveFaultError, LimitError, StateError
from drivers.set_points import SetPointSettings
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.calibration.straightness import straightness_of
from hil.correction.compensation import Compensation
from hil.correction.tables import DirectionalTable, TableSet
from hil.machine.axes_wiring import connected_across
from hil.machine.machine import Machine
from hil.machine.measure import bidirectional_steps, measure
from hil.machine.session import AxisSession, PositionReading
from hil.machine.set_points import CommandState
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from sim_backends.bench import Bench
from sim_backends.faults import Fault, FaultKind
from sim_backends.plant.parameters import bent_axis

pytestmark = pytest.mark.usefixtures("passwords")

SEED = 5  # of X (`support.two_axes`)
Floats = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def true_um(at_mm: Floats) -> Floats:
    """The simulated guideway's deviation from the straight line through it."""
    shape = bent_axis(SEED).guideway.straightness_um
    values = np.array([shape.value(float(x)) for x in at_mm])
    return np.asarray(values - np.polyval(np.polyfit(at_mm, values, 1), at_mm))


def table_of_truth() -> Compensation:
    """What moves Y exactly against X's way, at 49 places."""
    nodes = np.linspace(10.0, 490.0, 49)
    straightness = DirectionalTable.alike(nodes, -true_um(nodes))
    tables = TableSet.zero(nodes)
    return Compensation(TableSet(tables.mode, tables.pitch, None, None, straightness, "Y"))


def run_json(argv: list[str], path: Path) -> dict[str, dict[str, float]]:
    assert main([*argv, "--json", str(path)]) == 0
    found: dict[str, dict[str, float]] = json.loads(path.read_text())
    return found


@pytest.mark.outside
def test_measured_proven_stored_and_in_force_at_other_targets(tmp_path: Path) -> None:
    x, y = lay_out_bent(tmp_path, "modbus-tcp")
    assert main(["calibrate", str(y)]) == 0  # its backlash, some 8 µm, would swallow every reversal of the correction
    found = run_json(["straightness", str(x)], tmp_path / "s.json")
    straightness = found["tables"]["straightness"]
    nodes = np.array(straightness["position_mm"])  # type: ignore[index]
    for column in ("plus_um", "minus_um"):
        assert np.array(straightness[column]) == pytest.approx(-true_um(nodes), abs=0.2)  # type: ignore[index]
    assert found["before"]["range_um"] > 14.0
    assert found["after"]["range_um"] < 2.0  # 13 places 38 mm apart, straight between them
    assert found["after"]["rms_um"] < 0.1 * found["before"]["rms_um"]
    later = run_json(["verify", str(x), "--seed", "9"], tmp_path / "v.json")["straightness"]
    assert later["range_um"] < 2.0


@pytest.mark.outside  # four circles of a hundred seconds
def test_the_circle_streams_it_to_the_other_axis(tmp_path: Path) -> None:
    """Over CANopen: the same tables, with the straightness beside them and without, over 200 mm of X."""
    x, y = lay_out_bent(tmp_path, "canopen", other="ideal", sections=7)
    assert main(["calibrate", str(x), "--without-proof"]) == 0
    how = "--centre 240 200 --radius 100 --feed 1500 --period-ms 10"
    circle = ["circle", str(x), str(y), *how.split()]
    tables = run_json(circle, tmp_path / "tables.json")["circles"]["corrected"]
    assert main(["straightness", str(x)]) == 0
    straight = run_json(circle, tmp_path / "straight.json")["circles"]["corrected"]
    assert tables["roundness_um"] > 12.0  # type: ignore[index]
    assert straight["roundness_um"] < 0.35 * tables["roundness_um"]  # type: ignore[index]


@pytest.mark.parametrize(
    ("face", "period_s"),
    [("virtual", 0.01), ("canopen", 0.01), pytest.param("modbus-tcp", 0.02, marks=pytest.mark.outside)],
)
def test_a_stream_of_one_axis_moves_the_other_in_the_same_periods(tmp_path: Path, face: str, period_s: float) -> None:
    x, _ = lay_out_bent(tmp_path, face, other="ideal")
    lateral: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    with connected_across(load_axis(x)) as machine:
        session, bench = machine.session, bench_of(machine)
        session.prepare()
        for corrected in (False, True):
            session.compensation = table_of_truth() if corrected else None
            session.approach(30.0)
            session.move_to(40.0)
            path = [(40.0 + 100.0 * (1 - math.cos(math.pi * n / 400)), 40.0) for n in range(1, 401)]
            session.stream_along(
                path,
                SetPointSettings(period_s),
                lambda _, kept=lateral[corrected]: kept.append((bench.plant.motor_mm, bench.plant.lateral_um)),  # type: ignore[misc]
            )
    ranges = {}
    for corrected, samples in lateral.items():
        at, um = np.array(samples).T
        ranges[corrected] = float(np.ptp(um - np.polyval(np.polyfit(at, um, 1), at)))
    assert ranges[False] > 8.0
    assert ranges[True] < 0.8  # 10 mm between the places, and Y's servo behind its set-points


def test_while_straightness_moves_another_axis_the_own_place_is_estimated_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """[lost_motion] travel_by = "estimate" rests on where the drive shows the axis in each period."""
    x, _ = lay_out_bent(tmp_path, other="ideal")
    told: list[float] = []
    monkeypatch.setattr(CommandState, "found_at", lambda _state, place_mm: told.append(place_mm))
    with connected_across(load_axis(x)) as machine:
        session = machine.session
        session.prepare()
        session.compensation = table_of_truth()
        session.approach(30.0)
        session.move_to(40.0)
        path = [(40.0 + 0.1 * n, 10.0) for n in range(1, 101)]
        session.stream_along(path, SetPointSettings(0.01), lambda _: None)
    assert len(told) == len(path)
    assert told == pytest.approx([target_mm for target_mm, _ in path], abs=1.0)


def bench_of(machine: Machine) -> Bench:
    assert machine.bench is not None
    return machine.bench


# -- refused in one line -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("edit", "status", "words"),
    [
        (("X", 'axis_file = "Y.toml"', 'axis_file = "Z.toml"'), 2, "Z.toml: cannot be read"),
        (("X", 'axis_file = "Y.toml"', 'axis_file = "X.toml"'), 2, "names this axis itself"),
        (("X", "at_mm = 200.0", "at_mm = 200.0\nsign = 0"), 2, "[straightness] sign is 0"),
        (("X", "at_mm = 200.0", "at_mm = 200.0\nsign = -1"), 1, "its sign is wrong"),
        (("X", "at_mm = 200.0", 'at_mm = 200.0\ncolumn = "across_um"'), 2, "expected a column of straightness optics"),
        (("X", "at_mm = 200.0", "at_mm = 501.999"), 1, "502"),
        (("Y", "[correction]", "[correction]\nmax_correction_um = 5.0"), 1, "to axis Y"),
        (("Y", "[measurement]", "[measurement]\nhome = false"), 2, "axis Y is not homed"),
        (("X", "[correction]", "[correction]\nstraightness_share = 0.4"), 2, "corrects another axis"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line_and_nothing_is_stored(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], edit: tuple[str, str, str], status: int, words: str
) -> None:
    x, _ = lay_out_bent(tmp_path, other="ideal", sections=7)
    of, old, new = edit
    path = tmp_path / f"{of}.toml"
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    assert main(["straightness", str(x)]) == status
    said = capsys.readouterr().err.strip().splitlines()
    assert words in said[0]
    assert "may still move" not in said[0]  # the axis that was left first was not stopped again
    assert len(said) <= 2  # the second says how to go on
    assert not list(tmp_path.glob("X-campaign/tables.sealed"))


def test_a_table_that_moves_an_axis_which_is_not_there_is_refused_before_any_motion(tmp_path: Path) -> None:
    x, _ = lay_out_bent(tmp_path, other="ideal")
    with connected(load_axis(x)) as machine:
        with pytest.raises(StateError, match="moves axis Y, which is not connected here"):
            machine.session.prepare(compensation=table_of_truth())
        assert machine.session.drive.sample().state is not DriveState.ENABLED
        with pytest.raises(StateError, match="moves axis Y, which is not connected here"):
            machine.session.compensation = table_of_truth()


def test_it_is_in_force_only_while_the_other_axis_stands_ready(tmp_path: Path) -> None:
    x, _ = lay_out_bent(tmp_path, other="ideal")
    not_ready = pytest.raises(StateError, match="axis Y, which straightness moves, is not ready")
    with connected_across(load_axis(x)) as machine, not_ready:
        machine.session.compensation = table_of_truth()


def test_while_the_other_axis_has_no_place_this_one_is_not_moved(tmp_path: Path) -> None:
    x, _ = lay_out_bent(tmp_path, other="ideal")
    with connected_across(load_axis(x)) as machine:
        session = machine.session
        session.prepare()
        session.compensation = table_of_truth()
        session.move_to(60.0)
        assert session.cross is not None
        session.cross.without_power()
        for move in (
            lambda: session.move_to(70.0),
            lambda: session.stream_along([(60.1, 1.0)], SetPointSettings(0.01), lambda _: None),
        ):
            with pytest.raises(StateError, match=r"the motion so far is unknown|drive Y cannot stream"):
                move()
        assert bench_of(machine).plant.motor_mm == pytest.approx(60.0, abs=0.05)


# -- both stop ---------------------------------------------------------------------------------------------------------
def fault(bench: Bench) -> None:
    bench.servo.raise_fault(0x8611)


def torque_off(bench: Bench) -> None:
    bench.servo.power_off()


@pytest.mark.parametrize(
    ("face", "trouble", "error"),
    [
        ("virtual", fault, DriveFaultError),
        ("canopen", fault, DriveFaultError),
        ("modbus-tcp", fault, DriveFaultError),
        ("virtual", torque_off, StateError),
    ],
)
def test_trouble_at_the_other_axis_stops_the_moving_one(
    tmp_path: Path, face: str, trouble: Callable[[Bench], None], error: type[BridgeError]
) -> None:
    x, _ = lay_out_bent(tmp_path, face, other="ideal")
    stack = ExitStack()
    machine = stack.enter_context(connected_across(load_axis(x)))
    session, bench = machine.session, bench_of(machine)
    session.prepare()
    session.compensation = table_of_truth()
    session.move_to(60.0)
    other, begin_ns = bench.across, session.clock.now_ns() + 300_000_000
    assert other is not None

    def advance(now_ns: int, _dt_s: float) -> None:
        if begin_ns <= now_ns < begin_ns + 6_000_000:
            trouble(other)

    bench.clock.attach(advance)
    with pytest.raises(error) as caught:
        session.move_to(460.0)
    bench.clock.sleep_s(0.5)
    stood_mm = bench.plant.motor_mm
    assert 62.0 < stood_mm < 300.0  # on its way
    bench.clock.sleep_s(0.5)
    assert bench.plant.motor_mm == pytest.approx(stood_mm, abs=0.01)
    with suppress(BridgeError):
        stack.__exit__(error, caught.value, None)


def test_an_error_of_the_moving_axis_stops_the_other_too(tmp_path: Path) -> None:
    x, _ = lay_out_bent(tmp_path, "canopen", other="ideal")
    with connected_across(load_axis(x)) as machine:
        session = machine.session
        session.prepare()
        session.compensation = table_of_truth()
        session.move_to(60.0)
        assert session.cross is not None
        with pytest.raises(LimitError):
            session.stream_along([(60.001, 1.0), (503.0, 1.0)], SetPointSettings(0.01), lambda _: None)
        assert not session.cross.ready
        assert session.cross.drive.sample().state is not DriveState.ENABLED
        session.supervisor.stop()
        with pytest.raises(StateError):
            session.move_to(70.0)


def test_the_other_axis_is_without_power_while_a_person_works_in_the_machine(tmp_path: Path) -> None:
    x, _ = lay_out_bent(tmp_path, other="ideal")
    with connected_across(load_axis(x)) as machine:
        session = machine.session
        session.prepare()
        session.compensation = table_of_truth()
        assert session.cross is not None
        with session.without_power():
            assert session.cross.drive.sample().state is not DriveState.ENABLED
        assert session.cross.ready
        session.move_to(60.0)


def test_after_a_lost_signal_both_axes_find_their_places_again(tmp_path: Path) -> None:
    x, _ = lay_out_bent(tmp_path, other="ideal", sections=5)
    x.write_text(x.read_text().replace("[instrument]", "[instrument]\nresume_within_s = 20.0"))
    axis = load_axis(x)
    with connected_across(axis) as machine:
        session, bench = machine.session, bench_of(machine)
        session.prepare()
        session.compensation = table_of_truth()
        lost_s = session.clock.now_ns() / 1e9 + 8.0
        bench.laser.schedule((Fault(FaultKind.BEAM_LOST, lost_s, 1.0),))
        campaign = Campaign(tmp_path / "lost", axis.purpose("lost"), resume=False)
        records = measure(session, campaign, "after", bidirectional_steps(axis.measurement.targets_mm, 2))
    assert "signal back" in (tmp_path / "lost" / "after.csv").read_text()
    assert len(records) == 20
    assert straightness_of(records, "straightness_um").range_um < 0.5


def test_interrupted_in_its_proof_it_goes_on_with_the_rows_there_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    x, _ = lay_out_bent(tmp_path, other="ideal", sections=9)
    reads, left = AxisSession.read_position, [36 + 32 + 5]  # in the third pass, with the correction in force

    def cut_off(session: AxisSession) -> PositionReading:
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt
        return reads(session)

    monkeypatch.setattr(AxisSession, "read_position", cut_off)
    assert main(["straightness", str(x)]) == 130
    assert "hil straightness" in capsys.readouterr().err  # how to go on
    rows = tmp_path / "X-campaign" / "straightness-001" / "after.csv"
    kept = rows.read_text()
    assert main(["straightness", str(x), "--resume"]) == 0
    assert rows.read_text().startswith(kept)
    assert (tmp_path / "X-campaign" / "tables.sealed").exists()
