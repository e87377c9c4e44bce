"""What a correction costs: a set-point of a stream against bare bisection, a million positions against numpy.interp.

A set-point is all that a stream asks of the engine in a period: the command with its checks, and the note that the drive has it.
What is prepared at a stream's begin has a line of its own.

In force: a table of 200 places for both directions, the lost motion of two tanh terms with its state, a cyclic error and a thermal
expansion. Bare is what a user would write in Python for the table alone: bisect, and a straight line between two places.
"""

from __future__ import annotations

from bisect import bisect_right
from statistics import median

import numpy as np
from support.bench import Record, median_ratio, row, side_by_side

from hil.correction.compensation import Compensation, MotionHistory
from hil.correction.rise import TWO_TANH, Rise
from hil.correction.streamed import StreamedCorrection
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.effects import ALL, Form, NonLinear, Term
from hil.effects.warming import TEMPERATURE
from hil.machine.set_points import CommandState

NODES = np.linspace(0.0, 500.0, 200)
PITCH_UM = 6.0 * np.sin(NODES / 60.0)
TABLES = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(NODES, PITCH_UM, PITCH_UM - 8.0))
RISE = Rise(TWO_TANH, (5.0, 3.0), (0.2, 1.0, 0.5))
BY_ID = {effect.id: effect for effect in ALL}
EFFECTS = (
    Term(
        BY_ID["cyclic"],
        Form("cyclic", "fundamental", ("target_mm",), {}, (NonLinear("period_mm", 1.0, 250.0),)),
        (10.0,),
        (1.2, 0.5),
        ((0.0,) * 3,) * 3,
    ),
    Term(
        BY_ID["thermal_expansion"],
        Form("thermal_expansion", TEMPERATURE, ("temp_screw_c", "target_mm")),
        (),
        (11.0,),
        ((0.0,),),
    ),
)
SET_POINTS, ROUNDS = 2000, 15
PERIOD_MS = 2.0
POSITIONS = 1_000_000


def _stream() -> list[float]:
    """Set-points of a stream to and fro, 0.4 mm apart, with a reversal every 250."""
    place, step, found = 200.0, 0.4, []
    for number in range(SET_POINTS):
        step = -step if number % 250 == 249 else step
        place += step
        found.append(place)
    return found


def test_one_set_point(record_property: Record) -> None:
    targets = _stream()
    state = CommandState()
    state.compensation = Compensation(TABLES, EFFECTS, RISE)
    known = {"temp_screw_c": 24.0, "time_s": 1.0, "velocity_mm_s": 40.0}

    def begin() -> StreamedCorrection:
        state.set_position(MotionHistory(200.0, 1), 200.0)
        return state.stream(known)

    (prepared,) = side_by_side((begin,), ROUNDS)
    points = begin()

    def ours() -> None:
        for target in targets:
            points.command_mm(target)
            points.issued()

    places, values = NODES.tolist(), PITCH_UM.tolist()

    def bare() -> None:
        commands: list[float] = []
        for target in targets:
            at = bisect_right(places, target) - 1
            share = (target - places[at]) / (places[at + 1] - places[at])
            correction = values[at] + share * (values[at + 1] - values[at])
            commands.append(target + correction / 1000.0)

    mine, theirs = side_by_side((ours, bare), ROUNDS)
    each_us = [1e6 * median(times) / SET_POINTS for times in (mine, theirs)]
    row(
        record_property,
        "one corrected set-point of a stream",
        *each_us,
        "µs",
        beside="bisect and interpolation alone",
        ratio=median_ratio(mine, theirs),
        asked="≤ 3",
    )
    row(
        record_property,
        "preparation of that correction, at rest",
        1e3 * median(prepared),
        PERIOD_MS,
        "ms",
        beside="a period of the stream",
    )


def test_a_million_positions(record_property: Record) -> None:
    rng = np.random.default_rng(1)
    columns = {
        "target_mm": rng.uniform(0.0, 500.0, POSITIONS),
        "direction": np.sign(rng.uniform(-1.0, 1.0, POSITIONS)),
        "temp_screw_c": rng.uniform(20.0, 30.0, POSITIONS),
    }
    table, both = Compensation(TABLES), Compensation(TABLES, EFFECTS)
    runs = (
        lambda: table.correction_um(columns),
        lambda: both.correction_um(columns),
        lambda: np.interp(columns["target_mm"], NODES, PITCH_UM),
    )
    of_table, with_effects, bare = side_by_side(runs, 7)
    for name, mine, asked in (("table both ways", of_table, "≤ 1.5"), ("with two effects", with_effects, "≤ 3")):
        row(
            record_property,
            f"a million positions, {name}",
            1e3 * median(mine),
            1e3 * median(bare),
            "ms",
            beside="numpy.interp",
            ratio=median_ratio(mine, bare),
            asked=asked,
        )
