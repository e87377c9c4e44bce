"""The engine: at rest on a target the correction is the table's for its direction of arrival, whatever went before."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import InputError, StateError
from hil.axis.axis_file import CorrectionConfig
from hil.calibration.calibrate import as_stored
from hil.correction.bound import CorrectionBound
from hil.correction.compensation import Columns, Compensation, MotionHistory
from hil.correction.tables import (
    Band,
    DirectionalTable,
    SingleTable,
    TableMode,
    TableSet,
    compute_tables,
)
from hil.records.rows import Floats, Records

amounts = st.floats(-300, 300)
ANY = CorrectionBound(1e9, 1e9)
"""These tables are as wild as they come; what a bound refuses is tested with the bound."""


@dataclass(frozen=True)
class Machine:
    """Tables on common sections, and beside them the whole correction of every section, written down by hand."""

    tables: TableSet
    plus_um: list[float]
    minus_um: list[float]

    @property
    def sections_mm(self) -> list[float]:
        return list(self.tables.pitch.position_mm.tolist())

    def expected_um(self, target_mm: float, direction: int) -> float:
        index = bisect_left(self.sections_mm, target_mm)
        assert self.sections_mm[index] == target_mm
        return self.plus_um[index] if direction > 0 else self.minus_um[index]


@st.composite
def machines(draw: st.DrawFn) -> Machine:
    """Random tables in either mode, with and without specified accuracy and straightness, in every form of store."""
    at = sorted(draw(st.lists(st.integers(0, 500), min_size=1, max_size=8, unique=True)))

    def column() -> Floats:
        return np.array(draw(st.lists(amounts, min_size=len(at), max_size=len(at))))

    mode = draw(st.sampled_from(TableMode))
    plus, backlash = column(), column()
    unused = column()  # what stands in the table that the mode does not read must not matter
    minus = plus - backlash if mode is TableMode.BIDIRECTIONAL else unused
    total = {1: plus, -1: plus - backlash}
    pitch = DirectionalTable(np.array(at), plus, minus)
    if mode is TableMode.MEAN_BACKLASH:  # only the mean of the two is read
        mean = plus - backlash / 2
        pitch = DirectionalTable(np.array(at), mean + unused, mean - unused)
    tables = TableSet(mode, pitch, SingleTable(np.array(at), unused if mode is TableMode.BIDIRECTIONAL else backlash))
    if draw(st.booleans()):
        specified = DirectionalTable(np.array(at), column(), column())
        tables = replace(tables, specified=specified)
        total = {1: total[1] + specified.plus_um, -1: total[-1] + specified.minus_um}
    if draw(st.booleans()):
        straightness = SingleTable(np.array(at), column())
        tables = replace(tables, straightness=straightness)
        total = {sign: values + straightness.value_um for sign, values in total.items()}
    correction = CorrectionConfig(
        mode,
        Band(6, 7),
        4,
        0.1,
        3.0,
        combined=draw(st.booleans()),
        straightness_share=draw(st.sampled_from([0, 0.3, 1])),
    )
    return Machine(as_stored(tables, correction), total[1].tolist(), total[-1].tolist())


@given(st.data(), machines())
@settings(max_examples=300, deadline=None)
def test_at_rest_on_a_target_the_correction_is_the_tables_value_for_its_direction(
    data: st.DataObject, machine: Machine
) -> None:
    """Any sequence of targets, with restarts and homing between them; the expectation keeps its own account of direction."""
    engine = Compensation(machine.tables)
    # what a session does after homing: up to the reference, uncorrected
    history = MotionHistory(machine.sections_mm[0] - 1.0, 1).moved_to(machine.sections_mm[0])
    here, direction = machine.sections_mm[0], 1
    for event in data.draw(st.lists(st.sampled_from(["go", "go", "go", "home", "restart"]), max_size=25)):
        if event == "home":
            history = MotionHistory(machine.sections_mm[0] - 1.0, 1).moved_to(machine.sections_mm[0])
            here, direction = machine.sections_mm[0], 1
            continue
        if event == "restart":
            with pytest.raises(StateError, match="unknown"):
                engine.command(here, MotionHistory(here), {}, ANY)
            history, direction = MotionHistory(here), 0
            continue
        target = data.draw(st.sampled_from(machine.sections_mm) | st.floats(-10, 510))
        if target == here and direction == 0:
            with pytest.raises(StateError, match="unknown"):
                engine.command(target, history, {}, ANY)
            continue
        direction = direction if target == here else 1 if target > here else -1
        command = engine.command(target, history, {}, ANY)
        history, here = command.history, target
        assert history.direction == direction
        assert command.command_mm == pytest.approx(target + command.correction_um / 1000, abs=1e-12)
        if target in machine.sections_mm:
            assert command.correction_um == pytest.approx(machine.expected_um(target, direction), abs=1e-9)


@given(machines(), st.sampled_from([1, -1]), st.integers(1, 5))
@settings(max_examples=50, deadline=None)
def test_commanding_the_same_target_again_adds_nothing(machine: Machine, direction: int, times: int) -> None:
    engine = Compensation(machine.tables)
    target = machine.sections_mm[-1]
    command = engine.command(target, MotionHistory(target - direction), {}, ANY)
    for _ in range(times):
        again = engine.command(target, command.history, {}, ANY)
        assert again == command


class LostMotionMachine:
    """A table on a screw with play: it follows the motor only where the play is used up; written without the engine's code."""

    def __init__(self, play_mm: float, wave_um: float) -> None:
        self.play_mm = play_mm
        self.wave_um = wave_um
        self.motor_mm = 0.0
        self.nut_mm = 0.0

    def go(self, command_mm: float) -> float:
        self.motor_mm = command_mm
        self.nut_mm = min(max(self.nut_mm, command_mm - self.play_mm / 2), command_mm + self.play_mm / 2)
        return self.nut_mm + self.wave_um / 1000 * math.sin(self.nut_mm / 17)


@given(
    st.floats(0, 0.08),
    st.floats(-20, 20),
    st.sampled_from(TableMode),
    st.lists(st.integers(0, 10), min_size=1, max_size=30),
)
@settings(max_examples=100, deadline=None)
def test_a_machine_with_play_stands_on_its_targets_after_any_sequence(
    play_mm: float, wave_um: float, mode: TableMode, visits: list[int]
) -> None:
    """Play of up to 80 µm counted twice would show as up to 80 µm; what is left comes from the wave's slope, 1.2 µm/mm."""
    machine = LostMotionMachine(play_mm, wave_um)
    targets = [50.0 * i for i in range(11)]
    rows: list[tuple[float, float, float, float]] = []
    machine.go(-1.0)
    rows += [(1, 1, target, machine.go(target)) for target in targets]
    machine.go(501.0)
    rows += [(1, -1, target, machine.go(target)) for target in reversed(targets)]
    table = np.array(rows)
    records = Records.of(dict(zip(("run", "direction", "target_mm", "measured_mm"), table.T, strict=True)))
    engine = Compensation(compute_tables(records, mode))
    machine.go(-1.0)
    machine.go(0.0)
    history = MotionHistory(-1.0, 1).moved_to(0.0)
    for visit in visits:
        if history.position_mm == targets[visit]:
            continue
        command = engine.command(targets[visit], history, {})
        history = command.history
        assert machine.go(command.command_mm) == pytest.approx(targets[visit], abs=0.15e-3)


# -- the motion so far -------------------------------------------------------------------------------------------------


def test_history_after_strokes_and_reversals() -> None:
    start = MotionHistory(10.0)
    assert start.stroke_or_long_mm == 1e6
    up = start.moved_to(12.0).moved_to(15.0)
    assert (up.direction, up.since_reversal_mm, up.stroke_mm) == (1, 5.0, None)
    down = up.moved_to(14.0)
    assert (down.direction, down.since_reversal_mm, down.stroke_mm) == (-1, 1.0, 5.0)
    assert down.moved_to(14.0) is down
    again = down.moved_to(13.0).moved_to(20.0)
    assert (again.direction, again.since_reversal_mm, again.stroke_mm) == (1, 7.0, 2.0)


@given(st.floats(-100, 100), st.lists(st.floats(-100, 100), min_size=1, max_size=20))
@settings(max_examples=100, deadline=None)
def test_history_is_that_of_the_whole_path(start: float, path: list[float]) -> None:
    """Against a recount of the whole path at every point."""
    history = MotionHistory(start)
    walked = [start]
    for target in path:
        history = history.moved_to(target)
        walked.append(target)
        moves = [(a, b) for a, b in pairwise(walked) if a != b]
        strokes: list[list[float]] = []
        last = 0
        for a, b in moves:
            sign = 1 if b > a else -1
            if sign != last:
                strokes.append([])
            strokes[-1].append(abs(b - a))
            last = sign
        assert history.direction == last
        assert history.since_reversal_mm == pytest.approx(sum(strokes[-1]) if strokes else 0.0)
        if len(strokes) > 1:
            assert history.stroke_mm == pytest.approx(sum(strokes[-2]))
        else:
            assert history.stroke_mm is None


# -- terms ---------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Warm:
    """An effect term: grows with position and temperature."""

    needs: tuple[str, ...] = ("target_mm", "temp_screw_c")

    def error_um(self, columns: Columns) -> Floats:
        return columns["target_mm"] * (columns["temp_screw_c"] - 20.0) * 0.01


@dataclass(frozen=True)
class Winding:
    """An effect term that depends on the motion: travel since the reversal and the stroke before it."""

    needs: tuple[str, ...] = ("direction", "since_reversal_mm", "stroke_mm")

    def error_um(self, columns: Columns) -> Floats:
        return columns["direction"] * columns["since_reversal_mm"] + columns["stroke_mm"]


def flat(value_um: float) -> TableSet:
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable.constant(np.array([0.0, 100.0]), value_um))


def test_the_error_of_a_term_is_taken_off_the_correction() -> None:
    command = Compensation(flat(5.0), (Warm(),)).command(100.0, MotionHistory(0.0), {"temp_screw_c": 23.0})
    assert command.correction_um == pytest.approx(5.0 - 100 * 3 * 0.01)
    assert command.command_mm == pytest.approx(100.002)


def test_the_motion_itself_is_given_to_the_terms_and_no_sensor_can_override_it() -> None:
    history = MotionHistory(0.0, 1, 30.0, None)
    known = {"direction": 1.0, "since_reversal_mm": 1e3, "stroke_mm": 1e3, "target_mm": 1e3}
    command = Compensation(flat(0.0), (Winding(),)).command(-4.0, history, known)
    assert command.correction_um == pytest.approx(-(-1.0 * 4.0 + 30.0))


def test_a_term_without_its_sensor_is_refused_by_name() -> None:
    with pytest.raises(StateError, match="temp_screw_c"):
        Compensation(flat(0.0), (Warm(),)).command(1.0, MotionHistory(0.0), {})


def test_a_row_of_columns_gives_what_single_commands_give() -> None:
    engine = Compensation(flat(5.0), (Warm(),))
    columns = {
        "target_mm": np.array([10.0, 20.0]),
        "direction": np.array([1.0, -1.0]),
        "temp_screw_c": np.array([21.0, 22.0]),
    }
    assert engine.correction_um(columns) == pytest.approx([5.0 - 0.1, 5.0 - 0.4])


@pytest.mark.parametrize("target", [math.nan, math.inf, -math.inf])
def test_a_target_that_is_no_position_is_refused(target: float) -> None:
    with pytest.raises(InputError, match="finite"):
        Compensation(flat(0.0)).command(target, MotionHistory(0.0, 1), {})
