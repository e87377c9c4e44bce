"""The bound of a correction: nothing beyond it is commanded, stored, opened, downloaded or exported, and the worst place is named."""

from __future__ import annotations

import contextlib
import json
import math
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support import bench_axis
from support.toy_axis import MEASUREMENT, ToyMachine, toy_session

from drivers.errors import CorrectionBoundError
from hil.app.main import main
from hil.axis.axis_file import CorrectionConfig, load_axis
from hil.axis.lost_motion import LostMotionConfig
from hil.calibration.calibrate import calibrate
from hil.correction.bound import CAREFUL, SLOPE_OVER_MM, CorrectionBound
from hil.correction.compensation import Columns, Compensation, MotionHistory
from hil.correction.store import SealedStore
from hil.correction.streamed import StreamedCorrection
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.diagnosis.loop.procedure import bounded
from hil.effects import ALL, Form, Term
from hil.effects.history import through
from hil.effects.model import Model, PitchTable
from hil.lost_motion.procedure import measure_lost_motion
from hil.machine.measure import BASE_COLUMNS, bidirectional_steps
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from hil.records.rows import Floats, Records

READING, KEY = bench_axis.PASSWORDS["HIL_PASSWORD"], bench_axis.PASSWORDS["HIL_KEY_PASSWORD"]
FROZEN_MM = 463.0
"""What a laser that stood still made of an axis's travel."""


def bidirectional(at: list[float], plus: list[float], minus: list[float] | None = None) -> TableSet:
    return TableSet(
        TableMode.BIDIRECTIONAL, DirectionalTable(np.array(at), np.array(plus), np.array(minus if minus else plus))
    )


@dataclass(frozen=True)
class Sensed:
    """An effect by a sensor and by position."""

    per_unit: float
    per_mm: float
    needs: tuple[str, ...] = ("target_mm", "temp_screw_c")

    def error_um(self, columns: Columns) -> Floats:
        return columns["temp_screw_c"] * (self.per_unit + self.per_mm * columns["target_mm"])


numbers = st.floats(-1e7, 1e7) | st.floats(-50, 50)


@st.composite
def corrections(draw: st.DrawFn) -> Compensation:
    at = [0.01 * place for place in sorted(draw(st.lists(st.integers(0, 50_000), min_size=1, max_size=6, unique=True)))]
    column = st.lists(numbers, min_size=len(at), max_size=len(at))
    terms = (Sensed(draw(st.floats(-5, 5)), draw(st.floats(-0.1, 0.1))),) if draw(st.booleans()) else ()
    return Compensation(bidirectional(at, draw(column), draw(column)), terms)


bounds = st.builds(CorrectionBound, st.floats(1, 1e4), st.floats(0.1, 100))


@given(st.data(), corrections(), bounds)
@settings(max_examples=60)
def test_no_command_ever_leaves_the_bound(
    data: st.DataObject, compensation: Compensation, bound: CorrectionBound
) -> None:
    """Whatever the tables are, whatever a sensor says, however it jumps from one command to the next."""
    history = MotionHistory(0.0, 1)
    for _ in range(6):
        target = data.draw(st.floats(-10, 510) | st.sampled_from(compensation.tables.pitch.position_mm.tolist()))
        known = {"temp_screw_c": data.draw(st.floats(-1e6, 1e6) | st.floats(15, 35) | st.just(np.nan))}
        command = None
        with contextlib.suppress(CorrectionBoundError):
            command = compensation.command(target, history, known, bound)
        if command is None:
            continue
        assert abs(command.command_mm - target) * 1000 <= bound.max_um * (1 + 1e-6) + 1e-9
        near = np.array([target, target + SLOPE_OVER_MM / 2, target - SLOPE_OVER_MM / 2])
        around = compensation.correction_um(
            {
                "target_mm": near,
                "direction": np.full(3, float(command.history.direction)),
                "temp_screw_c": np.full(3, known["temp_screw_c"]),
            }
        )
        assert np.ptp(around) <= bound.max_slope_um_per_mm * (1 + 1e-6) + 1e-9
        history = command.history


@given(corrections().map(lambda one: replace(one, terms=())), bounds)
@settings(max_examples=60)
def test_tables_that_pass_hold_the_bound_everywhere_and_those_that_do_not_break_it_where_it_says(
    compensation: Compensation, bound: CorrectionBound
) -> None:
    """Against a table looked at anywhere, also beyond its ends."""
    nodes = compensation.tables.pitch.position_mm
    fine = np.linspace(nodes[0] - 2, nodes[-1] + 2, 4001)
    said = ""
    try:
        compensation.check(bound, "tables")
    except CorrectionBoundError as error:
        said = str(error)
    if said:
        places = [float(text) for text in re.findall(r"(?:at|between|and) (-?[\d.e+-]+)", said)]
        assert all(nodes[0] - 1.001 <= place <= nodes[-1] + 1.001 for place in places)
        worst = max(np.max(np.abs(compensation.tables.correction_um(nodes, sign))) for sign in (1, -1))
        if "max_correction_um" in said:
            assert worst > bound.max_um
            size = max(abs(float(compensation.tables.correction_um(places[0], sign))) for sign in (1, -1))
            assert size == pytest.approx(worst, rel=1e-3)
        else:
            low, high = places
            changes = [np.ptp(compensation.tables.correction_um([low, high], sign)) for sign in (1, -1)]
            assert max(changes) > bound.max_slope_um_per_mm * 0.99 or high - low < 1e-3
            assert high - low <= SLOPE_OVER_MM * 1.001
    else:
        for sign in (1, -1):
            values = compensation.tables.correction_um(fine, sign)
            assert np.max(np.abs(values)) <= bound.max_um * (1 + 1e-6)
            later = compensation.tables.correction_um(fine + SLOPE_OVER_MM, sign)
            assert np.max(np.abs(later - values)) <= bound.max_slope_um_per_mm * (1 + 1e-6) + 1e-9


def test_the_careful_default_holds_cheap_screws_and_the_noise_of_two_targets_side_by_side() -> None:
    """Lead error of C10 over 500 mm with 100 µm of reversal and a cyclic error of 5 µm in 5 mm; 2 µm of noise within 0.01 mm."""
    at = np.arange(0.0, 500.0, 0.25)
    plus = 0.7 * at + 5.0 * np.sin(2 * np.pi * at / 5.0)
    Compensation(TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(at, plus, plus - 100.0))).check(CAREFUL, "tables")
    Compensation(bidirectional([10.0, 10.01, 20.0], [0.0, 2.0, 0.0])).check(CAREFUL, "tables")


@pytest.mark.parametrize(
    ("tables", "said"),
    [
        (bidirectional([0, 100, 200], [0, 510, 0], [0, 1, 0]), r"\+510 µm at 100 mm \(\+\), expected at most 500 µm"),
        (bidirectional([0, 100, 200], [0, 1, 0], [0, -501, 0]), r"-501 µm at 100 mm \(−\)"),
        (
            bidirectional([0, 100, 103], [0, 0, 60]),
            r"changes by 20 µm between 100 and 101 mm \(\+\), expected at most 10 µm",
        ),
        (bidirectional([0, 100, 100.2, 100.4], [0, 0, 11, 0]), r"changes by 11 µm between 100 and 100\.2 mm"),
        (
            replace(bidirectional([0, 100], [0, 0]), straightness=DirectionalTable.alike([0, 50], [0, 600])),
            r"\+600 µm at 50 mm",
        ),
        (
            replace(
                bidirectional([0, 100], [0, 0]),
                straightness=DirectionalTable.alike([0, 50], [0, 600]),
                straightness_axis="Y",
            ),
            r"to axis Y: \+600 µm at 50 mm",
        ),
    ],
)
def test_the_worst_place_is_named(tables: TableSet, said: str) -> None:
    with pytest.raises(CorrectionBoundError, match=said):
        Compensation(tables).check(CAREFUL, "tables")


def test_just_the_bound_is_inside_it() -> None:
    """500 µm and 10 µm within a millimetre; a level table has no slope, whatever slope is allowed."""
    bound = CorrectionBound(500.0, 10.0)
    bound.check_values("tables", [0.0, 1.0], [1, -1], [500.0, -500.0])
    bound.check_curves("tables", [0.0, 1.0, 2.0], {1: [490.0, 500.0, 500.0], -1: [0.0, -10.0, 0.0]})
    bound.check_command(1, [10.0, 9.5, 10.5], [500.0, 490.0, 500.0])
    CorrectionBound(500.0, 0.1).check_curves("tables", [0.0, 100.0], {1: [5.0, 5.0], -1: [-5.0, -5.0]})
    with pytest.raises(CorrectionBoundError, match=r"500.1 µm at 0 mm"):
        bound.check_values("tables", 0.0, 1, 500.1)
    with pytest.raises(CorrectionBoundError, match=r"changes by 10.1 µm between 9.5 and 10.5 mm"):
        bound.check_command(1, [10.0, 9.5, 10.5], [0.0, -5.05, 5.05])


def test_straightness_of_the_axis_itself_counts_with_the_rest_and_of_no_table_not_at_all() -> None:
    """30 µm of straightness take 30 µm of pitch back; an axis that is named without a table is moved by none."""
    at = np.array([0.0, 100.0])
    level = bidirectional([0, 100], [-30.0, -30.0])
    own = replace(level, straightness=DirectionalTable.constant(at, 30.0))
    Compensation(own).check(CorrectionBound(1.0), "tables")
    Compensation(replace(level, straightness_axis="Y")).check(CorrectionBound(31.0), "tables")
    across = replace(level, straightness=DirectionalTable.constant(at, 40.0), straightness_axis="Y")
    with pytest.raises(CorrectionBoundError, match=r"to axis Y: \+40 µm"):
        Compensation(across).check(CorrectionBound(35.0), "tables")


def test_an_effect_of_position_counts_with_the_tables() -> None:
    class Steep:
        needs = ("target_mm",)

        def error_um(self, columns: Columns) -> Floats:
            return 40.0 * np.sin(2 * np.pi * columns["target_mm"] / 2.5)

    compensation = Compensation(bidirectional([0, 100], [0, 0]), (Steep(),))
    with pytest.raises(CorrectionBoundError, match="changes by"):
        compensation.check(CAREFUL, "model")
    with pytest.raises(CorrectionBoundError, match="not commanded: changes by"):
        compensation.command(50.0, MotionHistory(40.0, 1), {})


def test_rows_show_what_a_sensor_makes_of_a_model() -> None:
    compensation = Compensation(bidirectional([0, 100], [0, 0]), (Sensed(2.0, 0.0),))
    compensation.check(CAREFUL, "model")  # nothing is known of the sensor here
    rows = {
        "target_mm": np.array([10.0, 20.0, 30.0]),
        "direction": np.array([1.0, -1.0, 1.0]),
        "temp_screw_c": np.array([20.0, 300.0, np.nan]),
    }
    with pytest.raises(CorrectionBoundError, match=r"model: -600 µm at 20 mm \(−\)"):
        compensation.check_rows(CAREFUL, "model", rows)
    compensation.check_rows(CAREFUL, "model", {**rows, "temp_screw_c": np.array([20.0, 22.0, np.nan])})


@pytest.mark.parametrize("near_um", [[np.nan, 0.0, 0.0], [0.0, np.nan, 0.0], [0.0, 0.0, np.inf], [501.0, 501.0, 501.0]])
def test_a_command_whose_correction_is_no_number_is_not_given(near_um: list[float]) -> None:
    with pytest.raises(CorrectionBoundError, match="not commanded"):
        CAREFUL.check_command(1, [10.0, 9.5, 10.5], near_um)
    with pytest.raises(CorrectionBoundError, match="rows: "):
        CAREFUL.check_values("rows", [10.0, 9.5, 10.5], 1.0, near_um)


def test_a_command_is_judged_at_its_target() -> None:
    """Beside it there is less: 505 µm at the target, 495 µm half a millimetre away."""
    with pytest.raises(CorrectionBoundError, match=r"505 µm at 10 mm"):
        CorrectionBound(500.0, 20.0).check_command(1, [10.0, 9.5, 10.5], [505.0, 495.0, 495.0])
    CorrectionBound(500.0, 20.0).check_command(1, [10.0, 9.5, 10.5], [495.0, 505.0, 505.0])


# -- on an axis --------------------------------------------------------------------------------------------------------


def frozen_rows(directory: Path) -> None:
    """A calibration's rows as a frozen laser left them."""
    campaign = Campaign(directory, {"kind": "calibrate"}, resume=False)
    with campaign.rows("measure", BASE_COLUMNS) as journal:
        for step in bidirectional_steps(MEASUREMENT.targets_mm, MEASUREMENT.runs):
            row = {"run": step.run, "direction": step.direction, "target_mm": step.target_mm, "measured_mm": FROZEN_MM}
            journal.append({**dict.fromkeys(BASE_COLUMNS, 0.0), **row, "command_mm": step.target_mm})


def test_tables_of_a_frozen_laser_are_refused_when_they_are_computed(tmp_path: Path) -> None:
    frozen_rows(tmp_path)
    machine, stored = ToyMachine(), list[TableSet]()
    correction = CorrectionConfig(TableMode.BIDIRECTIONAL, None, 4, 0.1, 3.0, combined=False, straightness_share=0.0)
    with toy_session(machine) as session:
        session.prepare()
        moved = machine.travel_since_reversal_mm
        with pytest.raises(CorrectionBoundError, match=r"computed from these runs not used: -463000 µm at 0 mm \(\+\)"):
            calibrate(session, Campaign(tmp_path, {"kind": "calibrate"}, resume=True), correction, stored.append)
        assert machine.travel_since_reversal_mm == moved
        assert session.compensation is None
    assert stored == []
    assert not list(tmp_path.glob("round-*"))


def test_a_session_puts_nothing_beyond_its_bound_into_force() -> None:
    with toy_session(ToyMachine()) as session:
        session.prepare()
        session.command_state.bound = CorrectionBound(50.0)
        for level_um, fits in ((49.0, True), (51.0, False)):
            one = Compensation(bidirectional([0, 100], [level_um, level_um]))
            if fits:
                session.compensation = one
                continue
            with pytest.raises(CorrectionBoundError):
                session.compensation = one
        assert session.compensation is not None
        assert float(session.compensation.tables.correction_um(0.0, 1)) == 49.0


def test_a_sensor_that_jumps_moves_nothing() -> None:
    machine = ToyMachine(temperatures={"screw": 20.0})
    with toy_session(machine) as session:
        session.prepare()
        session.command_state.bound = CorrectionBound(50.0)
        session.compensation = Compensation(bidirectional([0, 100], [0, 0]), (Sensed(2.0, 0.0),))
        session.move_to(30.0)
        machine.temperatures["screw"] = 30.0
        session.watch(0.1)
        assert session.known()["temp_screw_c"] == 30.0
        before = machine.motor_mm
        with pytest.raises(CorrectionBoundError, match="-60 µm at 40 mm"):
            session.move_to(40.0)
        with pytest.raises(CorrectionBoundError, match=r"-60 µm at 30\.01 mm"):  # a stream's
            session.set_point(session.set_points(), 30.01, 1.0)
        assert machine.motor_mm == before


def test_a_sensor_is_read_through_the_lag_of_the_effect_in_force() -> None:
    """1 µm/K through 60 s; the sensor goes from 20 to 30 °C at once and is read again a minute later."""
    machine = ToyMachine(temperatures={"screw": 20.0})
    drift = next(one for one in ALL if one.id == "thermal_drift")
    form = Form(drift.id, "lagged temperature", ("temp_screw_c", "time_s"))
    lagging = Term(drift, form, (60.0,), (1.0,), ((0.0, 0.0), (0.0, 0.0)))
    with toy_session(machine) as session:
        session.prepare()
        session.compensation = Compensation(bidirectional([0, 100], [0, 0]), (lagging,))
        assert session.move_to(30.0).correction_um == 0.0
        began_s = session.known()["time_s"]
        machine.temperatures["screw"] = 30.0
        session.watch(0.1)
        jumped_s = session.known()["time_s"]
        session.watch(60.0)
        command = session.move_to(40.0)
        passed_s, step_s = session.known()["time_s"] - jumped_s, jumped_s - began_s
    assert step_s < 1.0
    assert command.correction_um == pytest.approx(-10.0 * (1.0 - math.exp(-60.0 / 60.0)), abs=0.3)
    assert passed_s > 60.0
    stream = StreamedCorrection(
        Compensation(bidirectional([0, 100], [0, 0]), (lagging,)),
        MotionHistory(0.0).moved_to(10.0),
        10.0,
        {"temp_screw_c": 30.0, "time_s": 5.0, through("temp_screw_c", 60.0): 24.0},
        CorrectionBound(50.0),
    )
    assert (stream.command_mm(10.1) - 10.1) * 1000.0 == pytest.approx(-4.0)


def test_what_is_sealed_and_what_is_opened_is_held_against_the_axis_files_bound(tmp_path: Path) -> None:
    path = bench_axis.lay_out(tmp_path, correction="max_correction_um = 2000.0")
    wide = load_axis(path)
    assert wide.correction.bound == CorrectionBound(2000.0)
    with connected(wide) as machine:
        assert machine.session.command_state.bound == wide.correction.bound
    large = bidirectional([0, 100], [1500.0, 1500.0])
    SealedStore.of(wide, READING, KEY).save_tables(large)
    assert SealedStore.of(wide, READING).load().tables == large
    path.write_text(path.read_text().replace("max_correction_um = 2000.0", ""))
    careful = load_axis(path)
    assert careful.correction.bound == CAREFUL
    with pytest.raises(CorrectionBoundError, match=r"tables\.sealed: correction not used: \+1500 µm at 0 mm"):
        SealedStore.of(careful, READING).load()
    sealed = careful.tables_path.read_bytes()
    with pytest.raises(CorrectionBoundError, match=r"tables\.sealed: correction not stored: \+1500 µm at 0 mm"):
        SealedStore.of(careful, READING, KEY).save_tables(large)
    assert careful.tables_path.read_bytes() == sealed


def test_the_bound_is_no_part_of_what_a_campaign_measures(tmp_path: Path) -> None:
    """A campaign of before the bound, or one whose bound was stated later, can be gone on with."""
    path = bench_axis.lay_out(tmp_path)
    before = load_axis(path).purpose("calibrate")
    path.write_text(path.read_text().replace("[correction]", "[correction]\nmax_slope_um_per_mm = 3.0"))
    assert load_axis(path).correction.bound == CorrectionBound(max_slope_um_per_mm=3.0)
    assert load_axis(path).purpose("calibrate") == before
    json.dumps(before)


@pytest.mark.usefixtures("passwords")
def test_typed_and_exported_tables_are_held_against_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axis, typed, out = bench_axis.lay_out(tmp_path), tmp_path / "typed.csv", tmp_path / "x.comp"
    typed.write_text("position_mm,plus_um,minus_um\n0,0,0\n20,600,600\n260,600,600\n")
    for also in ([], ["--dry-run"]):
        assert main(["calibrate", str(axis), "--manual", str(typed), *also]) == 1
        assert "typed.csv: correction not stored: +600 µm at 20 mm (+)" in capsys.readouterr().err
    assert not (tmp_path / "X-campaign" / "tables.sealed").exists()
    export = ["export", str(typed), "--format", "linuxcnc", "--out", str(out)]
    assert main(export) == 1
    assert "typed.csv: correction not exported: +600 µm at 20 mm (+)" in capsys.readouterr().err
    assert not out.exists()
    assert main([*export, "--bound", "700", "40"]) == 0
    assert out.exists()


def test_a_lost_motion_beyond_it_is_refused_before_it_is_proven(tmp_path: Path) -> None:
    how = LostMotionConfig(
        at_mm=50.0, stroke_mm=2.0, places=12, finest_um=5.0, runs=2, proof_moves=4, shortest_rise_um=0.25
    )
    with toy_session(ToyMachine(play_mm=0.02)) as session:
        session.prepare()
        session.command_state.bound = CorrectionBound(15.0)
        campaign = Campaign(tmp_path, {"kind": "lost-motion"}, resume=False)
        with pytest.raises(
            CorrectionBoundError, match=r"by the lost motion measured not used: -20\.?\d* µm at .*\(−\)"
        ):
            measure_lost_motion(session, campaign, how, None)
    assert [path.name for path in tmp_path.glob("*.csv")] == ["strokes.csv"]


@pytest.mark.parametrize(
    ("temperature_c", "error_um", "said"), [(300.0, 0.0, "-600 µm at 20 mm"), (20.0, 700.0, "-700 µm at 0 mm")]
)
def test_what_a_diagnosis_adds_is_refused_before_it_is_stored(temperature_c: float, error_um: float, said: str) -> None:
    """The loop's last gate: what is fitted, along the axis and in the rows that it was fitted to."""
    model = Model(PitchTable.of([0.0, 100.0], [error_um] * 2, [error_um] * 2), (Sensed(2.0, 0.0),))  # type: ignore[arg-type]
    rows = Records.of(
        {
            "run": [1.0, 1.0],
            "direction": [1.0, -1.0],
            "target_mm": [10.0, 20.0],
            "measured_mm": [10.0, 20.0],
            "temp_screw_c": [20.0, temperature_c],
        }
    )
    with (
        toy_session(ToyMachine()) as session,
        pytest.raises(CorrectionBoundError, match=f"extended .* not used: {said}"),
    ):
        bounded(session, model, bidirectional([0, 100], [0, 0]), rows)
