"""The engine: at rest on a target the correction is the table's for its direction of arrival, whatever went before."""

from __future__ import annotations

import math
import pickle
from bisect import bisect_left
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import CorrectionBoundError, InputError, StateError
from hil.axis.axis_file import CorrectionConfig
from hil.calibration.calibrate import as_stored
from hil.correction.bound import CorrectionBound
from hil.correction.compensation import WOUND_SHARE, Columns, Compensation, MotionHistory
from hil.correction.rise import TWO_TANH, Rise
from hil.correction.running_lost_motion import wound_share
from hil.correction.tables import (
    INTERPOLATIONS,
    Band,
    DirectionalTable,
    SingleTable,
    TableMode,
    TableSet,
    compute_tables,
)
from hil.effects.history import BRANCH, with_branches
from hil.records.rows import Floats, Records

amounts = st.floats(-300, 300)
ANY = CorrectionBound(1e9, 1e9)
"""These tables are as wild as they come; what a bound refuses is tested with the bound."""


@dataclass(frozen=True)
class Machine:
    """Tables on common sections, and beside them the whole correction of every section, written down by hand."""

    tables: TableSet
    sections_mm: list[float]
    plus_um: list[float]
    minus_um: list[float]

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
        straightness = DirectionalTable(np.array(at), column(), column())
        tables = replace(tables, straightness=straightness)
        total = {1: total[1] + straightness.plus_um, -1: total[-1] + straightness.minus_um}
    correction = CorrectionConfig(
        mode,
        Band(6, 7),
        4,
        0.1,
        3.0,
        combined=draw(st.booleans()),
        interpolation=draw(st.sampled_from(INTERPOLATIONS)),
        straightness_share=draw(st.sampled_from([0, 0.3, 1])),
    )
    return Machine(as_stored(tables, correction), [float(each) for each in at], total[1].tolist(), total[-1].tolist())


@given(st.data(), machines())
@settings(max_examples=80)
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
@settings(max_examples=50)
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
@settings(max_examples=50)
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


def test_strokes_of_the_first_motion_and_after_every_loop_has_closed() -> None:
    """0 → 10 → 4 → 11 mm: at first as after a long stroke; past 10 mm no reversal is remembered, as after a full stroke."""
    history, long_mm = MotionHistory(0.0), 1e6
    for target_mm, strokes_mm in (
        (6.0, (6.0, long_mm, long_mm, long_mm)),
        (10.0, (10.0, long_mm, long_mm, long_mm)),
        (4.0, (6.0, long_mm, long_mm, long_mm)),
        (9.0, (5.0, 6.0, long_mm, long_mm)),
        (11.0, (long_mm,) * 4),
    ):
        history = history.moved_to(target_mm)
        row = history.columns()
        assert tuple(row[name] for name in BRANCH) == strokes_mm


@given(st.floats(-100, 100), st.lists(st.floats(-100, 100), min_size=1, max_size=20))
@settings(max_examples=50)
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


@given(st.lists(st.integers(-400, 400), min_size=1, max_size=30))
@settings(max_examples=60)
def test_the_engine_remembers_the_strokes_that_the_diagnosis_rebuilds_from_its_rows(path: list[int]) -> None:
    """A row holds a place, the travel since the reversal and the stroke before it."""
    history = MotionHistory(1000.0).moved_to(0.0).moved_to(1000.0)
    rows = [(history := history.moved_to(500.0 + place)).columns() for place in path]
    names = ("target_mm", "direction", "since_reversal_mm", "stroke_mm")
    rebuilt = with_branches({name: np.array([row[name] for row in rows]) for name in names})
    for name in BRANCH:
        assert rebuilt[name] == pytest.approx([row[name] for row in rows], abs=1e-6)


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


@given(st.integers(0, 1000), st.sampled_from(list(TableMode)), st.booleans())
def test_single_commands_are_those_of_the_arrays(seed: int, mode: TableMode, rising: bool) -> None:
    """All parts of a table set, on nodes of their own, beyond the ends too: a command is what `correction_um` gives its row."""
    rng = np.random.default_rng(seed)

    def nodes() -> Floats:
        return np.unique(np.round(rng.uniform(0.0, 100.0, rng.integers(1, 8)), 3))

    at = [nodes() for _ in range(4)]
    tables = TableSet(
        mode,
        DirectionalTable(at[0], rng.normal(size=len(at[0])), rng.normal(size=len(at[0]))),
        SingleTable(at[1], rng.normal(size=len(at[1]))),
        DirectionalTable(at[2], rng.normal(size=len(at[2])), rng.normal(size=len(at[2]))) if seed % 2 else None,
        DirectionalTable(at[3], *rng.normal(size=(2, len(at[3])))) if seed % 3 else None,
    )
    compensation = Compensation(
        tables, (Warm(), Winding()), Rise(TWO_TANH, (2.0, 1.0), (0.2, 1.0, 0.5)) if rising else None
    )
    history = MotionHistory(50.0, 1, 30.0, 40.0)
    for target_mm in [*rng.uniform(-20.0, 120.0, 6), *at[0][:2], *at[2][-1:]]:
        command = compensation.command(float(target_mm), history, {"temp_screw_c": 20.001}, CorrectionBound(1e6, 1e6))
        after = command.history
        row = {
            "target_mm": target_mm,
            "direction": after.direction,
            "temp_screw_c": 20.001,
            "since_reversal_mm": after.since_reversal_mm,
            "stroke_mm": after.stroke_or_long_mm,
        }
        if compensation.rise is not None:
            row[WOUND_SHARE] = wound_share(compensation.rise, target_mm, after.direction, after.turns_mm)
        (expected,) = compensation.correction_um({name: np.array([float(value)]) for name, value in row.items()})
        assert command.correction_um == pytest.approx(expected, rel=1e-9, abs=1e-9)
        history = after
    assert pickle.loads(pickle.dumps(compensation)) == compensation


# -- by hand: two directions, effects, a rise, another axis ---------------------------------------------------------------
ENDS_MM = np.array([0.0, 100.0])


def level(plus_um: float, minus_um: float) -> TableSet:
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(ENDS_MM, np.full(2, plus_um), np.full(2, minus_um)))


@dataclass(frozen=True)
class Known:
    """A term that reads these columns, and its error in µm."""

    needs: tuple[str, ...]
    um: float = 1.0

    def error_um(self, columns: Columns) -> Floats:
        return np.full(len(columns["target_mm"]), self.um)


@pytest.mark.parametrize(
    ("compensation", "takes_it_out"),
    [
        (Compensation(level(3.0, 3.0)), False),
        (Compensation(level(3.0, -1.0)), True),
        (Compensation(level(3.0, 3.0), (Known(("target_mm",)), Known(("temp_air_c",)))), False),
        (Compensation(level(3.0, 3.0), (Known(("target_mm",)), Known(("target_mm", "direction")))), True),
        (Compensation(level(3.0, 3.0), (Known(("since_reversal_mm",)),)), True),
        (Compensation(level(3.0, 3.0), (), Rise(TWO_TANH, (3.0, 1.0), (0.1, 0.4, 0.2))), True),
    ],
)
def test_what_takes_a_reversal_out(compensation: Compensation, takes_it_out: bool) -> None:
    assert compensation.corrects_reversal is takes_it_out


def test_the_axis_that_straightness_moves() -> None:
    beside = DirectionalTable(ENDS_MM, np.array([0.0, 1.0]), np.array([0.0, 5.0]))
    plain = level(3.0, 3.0)
    assert Compensation(plain).moves_axis == ""
    assert Compensation(replace(plain, straightness=beside)).moves_axis == ""
    across = Compensation(replace(plain, straightness=beside, straightness_axis="Z"))
    assert across.moves_axis == "Z"
    across.check(CorrectionBound(6.0), "tables")
    with pytest.raises(CorrectionBoundError, match=r"tables, to axis Z: \+5 µm at 100 mm"):
        across.check(CorrectionBound(4.0), "tables")


def test_a_rise_goes_from_one_direction_to_the_other() -> None:
    """10 µm in +, 4 µm in −: a quarter wound up 4 + 0.25·6 µm."""
    rising = Compensation(level(10.0, 4.0), (), Rise(TWO_TANH, (4.0, 2.0), (0.1, 0.4, 0.2)))
    rows = {"target_mm": np.array([50.0, 50.0, 50.0]), "direction": np.array([1.0, 1.0, -1.0])}
    shares = {WOUND_SHARE: np.array([0.0, 0.25, 1.0])}
    assert rising.correction_um(rows | shares) == pytest.approx([4.0, 5.5, 10.0])
    with pytest.raises(StateError, match=r"needs wound_share, which"):
        rising.correction_um(rows)


def test_the_lost_motion_rises_with_the_actual_motion_where_that_is_known() -> None:
    """The targets turned 20 mm ago and are in full; the axis itself turned just now, or has not moved yet."""
    rising = Compensation(level(10.0, 4.0), (), Rise(TWO_TANH, (4.0, 2.0), (0.1, 0.4, 0.2)))
    targets = MotionHistory(50.0, -1, 20.0).moved_to(30.0).moved_to(49.0)
    turned = MotionHistory(50.0, -1, 20.0).moved_to(30.0).moved_to(30.0001)
    still = MotionHistory(49.0)

    def corrected_um(actual: MotionHistory | None) -> float:
        return rising.command(50.0, targets, {}, ANY, actual).correction_um

    assert corrected_um(None) == pytest.approx(10.0, abs=1e-6)
    assert corrected_um(still) == pytest.approx(10.0, abs=1e-6)
    assert corrected_um(turned) == pytest.approx(4.0, abs=0.02)


def test_effects_of_position_are_taken_off_before_the_bound_is_asked() -> None:
    """A table of 6 µm and an error of 5 µm leave 1 µm; an error of −5 µm makes 11 µm of it."""
    Compensation(level(6.0, 6.0), (Known(("target_mm",), 5.0),)).check(CorrectionBound(2.0), "tables")
    with pytest.raises(CorrectionBoundError, match=r"\+11 µm"):
        Compensation(level(6.0, 6.0), (Known(("target_mm",), -5.0),)).check(CorrectionBound(10.0), "tables")


@dataclass(frozen=True)
class Bump:
    """An error of 8 µm within 0.2 mm of 40 mm alone."""

    needs: tuple[str, ...] = ("target_mm",)

    def error_um(self, columns: Columns) -> Floats:
        return np.where(np.abs(columns["target_mm"] - 40.0) < 0.2, 8.0, 0.0)


def test_effects_of_position_are_held_against_the_bound_between_the_nodes() -> None:
    with pytest.raises(CorrectionBoundError, match=r"-8 µm at (39|40)"):
        Compensation(level(0.0, 0.0), (Bump(),)).check(CorrectionBound(7.0, 100.0), "tables")


@dataclass
class Looking:
    """An effect of position without an error; it remembers where it was asked for."""

    needs: tuple[str, ...] = ("target_mm",)
    asked_mm: list[Floats] = field(default_factory=list)

    def error_um(self, columns: Columns) -> Floats:
        self.asked_mm.append(columns["target_mm"])
        return np.zeros(len(columns["target_mm"]))


@pytest.mark.parametrize("nodes_mm", [[0.0, 100.0], [-60.0, 60.0], [0.0, 1.0, 100.0], [5.0, 5.15]])
def test_effects_of_position_are_looked_at_from_end_to_end_no_more_than_a_tenth_apart(nodes_mm: list[float]) -> None:
    looking = Looking()
    Compensation(TableSet.zero(np.array(nodes_mm)), (looking,)).check(CorrectionBound(1.0), "tables")
    for asked_mm in looking.asked_mm:
        assert (asked_mm[0], asked_mm[-1]) == (nodes_mm[0], nodes_mm[-1])
        assert np.max(np.diff(asked_mm)) <= 0.1 + 1e-9
        assert set(nodes_mm) <= set(asked_mm)


@pytest.mark.parametrize(("way", "nodes_um"), [(1, [0.0, 600.0, 600.0]), (-1, [600.0, 600.0, 0.0])])
def test_the_slope_of_a_command_is_taken_half_a_millimetre_to_either_side(way: int, nodes_um: list[float]) -> None:
    """12 µm/mm up to 50 mm and level from there: 7.2 µm over the millimetre around 49.9 mm, 4.8 µm around 50.1 mm; and mirrored."""
    steep = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(np.array([0.0, 50.0, 100.0]), *[np.array(nodes_um)] * 2))
    history = MotionHistory(10.0, 1)
    for beyond_mm, refused in ((-0.5, True), (-0.1, True), (0.1, False), (0.6, False)):
        target_mm = 50.0 + way * beyond_mm
        engine, bound = Compensation(steep), CorrectionBound(1e4, 6.0)
        if refused:
            with pytest.raises(CorrectionBoundError, match="changes by"):
                engine.command(target_mm, history, {}, bound)
        else:
            engine.command(target_mm, history, {}, bound)
