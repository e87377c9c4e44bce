"""A pass: every target reached in its direction, every row on disk before the next motion, and taken up where it was left."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.toy_axis import LIMITS, MEASUREMENT, ToyMachine, Trouble, toy_session

from drivers.drive import DriveState
from drivers.errors import InputError, MeasurementLostError
from hil.axis.lost_motion import LostMotionConfig
from hil.correction.compensation import Compensation
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.lost_motion.procedure import proof_steps, stroke_steps
from hil.machine.events import Event, Point
from hil.machine.measure import BASE_COLUMNS, Step, bidirectional_steps, measure, other_targets, steps_for_sections
from hil.machine.session import AxisSession
from hil.records.journal import Campaign
from hil.records.rows import Records, read_csv

TARGETS = MEASUREMENT.targets_mm
STEPS = bidirectional_steps(TARGETS, MEASUREMENT.runs)


def campaign(path: Path, *, resume: bool = False) -> Campaign:
    return Campaign(path, {"kind": "test"}, resume=resume)


def prepared(machine: ToyMachine, then: Callable[[AxisSession], Records]) -> Records:
    with toy_session(machine) as session:
        session.prepare()
        return then(session)


# -- plans -----------------------------------------------------------------------------------------------------------------


def test_every_run_goes_up_through_all_targets_and_down_again() -> None:
    assert bidirectional_steps([5.0, 1.0], 2) == [
        Step(1, 1, 1.0),
        Step(1, 1, 5.0),
        Step(1, -1, 5.0),
        Step(1, -1, 1.0),
        Step(2, 1, 1.0),
        Step(2, 1, 5.0),
        Step(2, -1, 5.0),
        Step(2, -1, 1.0),
    ]


def test_only_the_wanted_sections_are_visited_each_in_its_direction() -> None:
    steps = steps_for_sections([(30.0, -1), (10.0, 1), (20.0, -1), (30.0, -1)], 2)
    assert steps == [
        Step(1, 1, 10.0),
        Step(1, -1, 30.0),
        Step(1, -1, 20.0),
        Step(2, 1, 10.0),
        Step(2, -1, 30.0),
        Step(2, -1, 20.0),
    ]


@given(st.integers(1, 10**6))
@settings(max_examples=50)
def test_other_targets_lie_one_in_each_interval_away_from_its_ends(seed: int) -> None:
    found = other_targets(MEASUREMENT, seed)
    assert found == other_targets(MEASUREMENT, seed)
    assert len(found) == len(TARGETS) - 1
    for low, target, high in zip(TARGETS, found, TARGETS[1:], strict=False):
        assert low + 0.19 * (high - low) < target < high - 0.19 * (high - low)


def test_what_a_drive_lets_know_in_a_move_is_kept_with_the_rows_and_told_once(tmp_path: Path) -> None:
    with toy_session(ToyMachine()) as session:
        drive = session.drive
        drive.notes = ["found by open"]
        session.untold_notes()
        session.prepare()
        heard: list[Event] = []

        def listen(event: Event) -> None:
            heard.append(event)
            if event.found is not None and event.done == 2:
                drive.notes = [*drive.notes, "it does not take 6084h"]

        measure(session, campaign(tmp_path), "pass", STEPS, listen)
        assert session.untold_notes() == []
    assert [event.message for event in heard if event.warning] == ["it does not take 6084h"]
    rows = (tmp_path / "pass.csv").read_text().splitlines()
    assert rows.count("# it does not take 6084h") == 1
    assert not any("found by open" in row for row in rows)


# -- measuring ---------------------------------------------------------------------------------------------------------------


@dataclass
class Witness:
    """What the machine itself did before each captured row: the direction it came from, and how far."""

    machine: ToyMachine
    seen: list[tuple[int, float]] = field(default_factory=list)

    def __call__(self, event: Event) -> None:
        if event.message:
            self.seen.append((self.machine.direction, self.machine.travel_since_reversal_mm))


@given(
    st.lists(
        st.builds(Step, st.integers(1, 3), st.sampled_from([1, -1]), st.sampled_from([0.0, 0.4, 30.0, 61.0, 100.0])),
        min_size=1,
        max_size=8,
    )
)
@settings(max_examples=40)
def test_every_target_is_reached_in_its_direction_after_at_least_the_overrun(
    tmp_path_factory: pytest.TempPathFactory, steps: list[Step]
) -> None:
    """In any order of steps, the same target twice among them; seen by the machine, not by the program's own history."""
    machine = ToyMachine()
    witness = Witness(machine)
    place = campaign(tmp_path_factory.mktemp("pass") / "c")
    records = prepared(machine, lambda session: measure(session, place, "measure", steps, witness))
    assert [direction for direction, _ in witness.seen] == [step.direction for step in steps]
    assert min(travel for _, travel in witness.seen) >= MEASUREMENT.overrun_mm - 1e-9
    assert records.target_mm.tolist() == [step.target_mm for step in steps]
    for step, (_, travel), since in zip(steps, witness.seen, records["since_reversal_mm"], strict=True):
        assert since == pytest.approx(travel), step
    assert LIMITS.travel_min_mm <= machine.lowest_mm
    assert machine.highest_mm <= LIMITS.travel_max_mm


def test_rows_say_what_happened(tmp_path: Path) -> None:
    machine = ToyMachine(play_mm=0.02, wave_um=0.0, temperatures={"screw": 21.0})
    records = prepared(machine, lambda session: measure(session, campaign(tmp_path), "measure", STEPS))
    assert tuple(records.columns) == (*BASE_COLUMNS, "temp_screw_c")
    # the datum is taken upwards: coming down, the table stands higher by the play
    expected = np.where(records.direction > 0, 0.0, 20.0)
    assert records.error_um == pytest.approx(expected, abs=1e-3)
    assert records.command_mm.tolist() == records.target_mm.tolist() == [step.target_mm for step in STEPS]
    assert np.all(np.diff(records["time_s"]) > 0)
    assert set(records["temp_screw_c"]) == {21.0}
    assert set(records["velocity_mm_s"]) == {0.0}
    assert np.all(np.isnan(records["torque_percent"]))
    assert records["motor_mm"] == pytest.approx(records.target_mm, abs=1e-9)


def test_the_correction_does_not_push_the_overrun_out_of_the_travel(tmp_path: Path) -> None:
    """The outermost targets stand one overrun from the ends of the travel, as the axis file allows."""
    at = np.array([-1.0, 101.0])
    outwards = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(at, np.array([-30.0, 30.0]), np.array([-30.0, 30.0])))
    machine = ToyMachine()
    with toy_session(machine, targets_mm=(-1.0, 101.0), reference_mm=-1.0) as session:
        session.prepare()
        session.compensation = Compensation(outwards)
        steps = bidirectional_steps((-1.0, 101.0), 1)
        records = measure(session, campaign(tmp_path), "round-1", steps)
    assert records.command_mm == pytest.approx([-1.03, 101.03, 101.03, -1.03])
    assert LIMITS.travel_min_mm <= machine.lowest_mm
    assert machine.highest_mm <= LIMITS.travel_max_mm


def test_progress_counts_every_row(tmp_path: Path) -> None:
    events: list[Event] = []
    prepared(ToyMachine(), lambda session: measure(session, campaign(tmp_path), "measure", STEPS, events.append))
    assert [event.done for event in events] == list(range(len(STEPS) + 1))
    assert {event.total for event in events} == {len(STEPS)}


# -- interrupted and taken up ----------------------------------------------------------------------------------------------------


def without_time(records: Records) -> list[list[float]]:
    """Rows as they would be without an interruption: all but the clock, and the stroke before, which homing changes."""
    names = [
        name for name in records.columns if name not in ("time_s", "stroke_mm", "since_reversal_mm", "torque_percent")
    ]
    return [[round(float(records[name][row]), 6) for name in names] for row in range(len(records))]


@pytest.mark.parametrize("seed", range(2))
def test_interrupted_at_random_moments_and_resumed_it_ends_with_the_same_rows(tmp_path: Path, seed: int) -> None:
    whole = prepared(
        ToyMachine(temperatures={"screw": 21.0}),
        lambda session: measure(session, campaign(tmp_path / "whole"), "measure", STEPS),
    )
    generator = random.Random(seed)
    path = tmp_path / "broken" / "measure.csv"
    confirmed: list[str] = []
    times = 0
    while True:
        machine = ToyMachine(
            temperatures={"screw": 21.0},
            motor_mm=generator.uniform(0, 100),
            trouble=Trouble(at_call=generator.randint(12, 220)),
        )
        place = campaign(tmp_path / "broken", resume=times > 0)
        times += 1
        try:
            records = prepared(machine, lambda session, place=place: measure(session, place, "measure", STEPS))
            break
        except KeyboardInterrupt:
            assert machine.state is not DriveState.ENABLED
            lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
            rows = [line for line in lines if not line.startswith("#")]
            assert rows[: len(confirmed)] == confirmed, "a row that was there is gone"
            confirmed = rows
        assert LIMITS.travel_min_mm <= machine.lowest_mm
        assert machine.highest_mm <= LIMITS.travel_max_mm
    assert times > 2
    assert without_time(records) == without_time(whole)
    assert np.all(np.diff(records["time_s"]) > 0)
    assert "# resumed after" in path.read_text(encoding="utf-8")


LOST_MOTION = LostMotionConfig(
    at_mm=50.0, stroke_mm=4.0, places=10, finest_um=4.0, runs=1, proof_moves=12, shortest_rise_um=0.25
)
STROKES = stroke_steps(LOST_MOTION)


def travelled(records: Records) -> np.ndarray:
    """(n, 2): error and travel since the last turning, µm; of the play's machine the one tells how much of it is wound up."""
    return np.column_stack([records.error_um, 1000.0 * records["since_reversal_mm"]])


@pytest.mark.outside
@pytest.mark.parametrize("steps", [STROKES, proof_steps(LOST_MOTION, 3)], ids=["strokes", "moves"])
def test_rows_that_go_on_from_the_one_before_are_the_same_wherever_they_were_interrupted(
    tmp_path: Path, steps: list[Step]
) -> None:
    """What a row holds is the travel behind it, which homing and the datum had taken away."""
    worn = {"play_mm": 0.05, "wave_um": 0.0}
    whole = travelled(
        prepared(ToyMachine(**worn), lambda session: measure(session, campaign(tmp_path / "whole"), "measure", steps))
    )
    assert len({round(error, 1) for error in whole[:, 0]}) > 2, "rows differ by the travel behind them"
    for rows in range(1, len(steps), 4):
        place, machine = campaign(tmp_path / str(rows)), ToyMachine(**worn)

        def interrupt(event: Event, rows: int = rows) -> None:
            if event.done == rows:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            prepared(machine, lambda session, place=place: measure(session, place, "measure", steps, interrupt))  # type: ignore[misc]
        again = campaign(tmp_path / str(rows), resume=True)
        resumed = prepared(ToyMachine(**worn), lambda session, again=again: measure(session, again, "measure", steps))  # type: ignore[misc]
        assert travelled(resumed) == pytest.approx(whole, abs=1e-3), f"resumed after {rows} rows"


def test_rows_stay_when_the_beam_breaks(tmp_path: Path) -> None:
    machine = ToyMachine(trouble=Trouble(beam_lost_at_s=12.0))
    with pytest.raises(MeasurementLostError, match="beam lost"):
        prepared(machine, lambda session: measure(session, campaign(tmp_path), "measure", STEPS))
    kept = len(read_csv(tmp_path / "measure.csv"))
    assert 0 < kept < len(STEPS)
    records = prepared(
        ToyMachine(), lambda session: measure(session, campaign(tmp_path, resume=True), "measure", STEPS)
    )
    assert len(records) == len(STEPS)


def test_rows_of_a_frozen_instrument_are_withdrawn_and_measured_again(tmp_path: Path) -> None:
    """Strokes of 0.2 mm may all be waited out within the stated reversal: it is noticed rows after it began."""
    small = [Step(1, sign, 20.0 + 0.2 * (sign > 0), overrun_mm=0.0, feed_mm_s=5.0) for sign in (1, -1) * 4]
    steps = [Step(1, 1, 20.0), *small, Step(1, 1, 60.0), Step(1, 1, 80.0)]
    whole = prepared(ToyMachine(), lambda session: measure(session, campaign(tmp_path / "whole"), "measure", steps))
    machine = ToyMachine()

    def freeze(event: Event) -> None:
        if event.done == 4:
            machine.trouble = Trouble(frozen_readings_at_s=machine.now_s)

    place = tmp_path / "frozen"
    with pytest.raises(MeasurementLostError, match="stands still"):
        prepared(machine, lambda session: measure(session, campaign(place), "measure", steps, freeze))
    written = (place / "measure.csv").read_text(encoding="utf-8")
    assert "# withdrawn 6: the instrument was not seen to follow the motor since" in written
    assert (
        len(read_csv(place / "measure.csv")) == 3
    )  # the fourth came before, and nothing moved after it that would show it
    again = prepared(ToyMachine(), lambda session: measure(session, campaign(place, resume=True), "measure", steps))
    assert again["measured_mm"] == pytest.approx(whole["measured_mm"], abs=1e-6)
    assert [*again.target_mm] == [step.target_mm for step in steps]


def test_a_pass_that_is_complete_moves_nothing(tmp_path: Path) -> None:
    first = prepared(ToyMachine(), lambda session: measure(session, campaign(tmp_path), "measure", STEPS))
    machine = ToyMachine()
    with toy_session(machine) as session:
        again = measure(session, campaign(tmp_path, resume=True), "measure", STEPS)
    assert machine.calls == [("disable", machine.motor_mm)]
    assert again["measured_mm"].tolist() == first["measured_mm"].tolist()


def test_a_sensor_that_comes_or_goes_does_not_stand_in_the_way(tmp_path: Path) -> None:
    """Slow channels are heard late: columns are those of the file, and a silent sensor leaves its cell empty."""
    machine = ToyMachine(temperatures={"screw": 21.0}, trouble=Trouble(at_call=330))
    with pytest.raises(KeyboardInterrupt):
        prepared(machine, lambda session: measure(session, campaign(tmp_path), "measure", STEPS))
    begun = len(read_csv(tmp_path / "measure.csv"))
    assert 0 < begun < len(STEPS)
    other = ToyMachine(temperatures={"nut": 30.0})
    records = prepared(other, lambda session: measure(session, campaign(tmp_path, resume=True), "measure", STEPS))
    assert "temp_nut_c" not in records
    assert np.all(records["temp_screw_c"][:begun] == 21.0)
    assert np.all(np.isnan(records["temp_screw_c"][begun:]))


def test_time_goes_on_across_passes_and_interruptions(tmp_path: Path) -> None:
    first = prepared(ToyMachine(), lambda session: measure(session, campaign(tmp_path), "measure", STEPS))
    with toy_session(ToyMachine()) as session:
        session.prepare()
        second = measure(session, campaign(tmp_path, resume=True), "round-1", STEPS)
        third = measure(session, campaign(tmp_path, resume=True), "round-2", STEPS)
    assert second["time_s"][0] > first["time_s"][-1]
    assert third["time_s"][0] > second["time_s"][-1]
    assert third["time_s"][0] - second["time_s"][-1] < 10.0


@pytest.mark.parametrize(
    "steps",
    [
        bidirectional_steps((0.0, 30.0, 61.0, 99.0), 2),
        bidirectional_steps((0.0, 30.0), 2),
        [*STEPS[1:], STEPS[0]],
        [Step(step.run, -step.direction, step.target_mm) for step in STEPS],
        [Step(step.run + 1, step.direction, step.target_mm) for step in STEPS],
    ],
)
def test_rows_of_another_plan_are_refused_before_anything_moves(tmp_path: Path, steps: list[Step]) -> None:
    prepared(ToyMachine(), lambda session: measure(session, campaign(tmp_path), "measure", STEPS))
    machine = ToyMachine()
    with (
        toy_session(machine) as session,
        pytest.raises(InputError, match=r"measure\.csv: row \d+ is not what the plan"),
    ):
        measure(session, campaign(tmp_path, resume=True), "measure", steps)
    assert machine.told("move") == []


def test_rows_measured_with_other_tables_are_refused(tmp_path: Path) -> None:
    prepared(ToyMachine(), lambda s: measure(s, campaign(tmp_path), "round-1", STEPS, comment="tables 0815"))
    with toy_session(ToyMachine()) as session, pytest.raises(InputError, match="0815"):
        measure(session, campaign(tmp_path, resume=True), "round-1", STEPS, comment="tables 4711")


def test_every_capture_is_a_point_of_the_graph(tmp_path: Path) -> None:
    heard: list[Event] = []
    records = prepared(ToyMachine(), lambda s: measure(s, campaign(tmp_path / "c"), "round-1", STEPS, heard.append))
    points = [event.found for event in heard if isinstance(event.found, Point)]
    ways = {1.0: "round-1, +", -1.0: "round-1, −"}
    assert [point.series for point in points] == [ways[way] for way in records.direction.tolist()]
    assert [(point.x, point.y) for point in points] == [
        (x, pytest.approx(y, abs=1e-3)) for x, y in zip(records.target_mm, records.error_um, strict=True)
    ]
