"""Set-points by the estimated actual position: how far the lost motion has come back is what the encoder has seen."""

from __future__ import annotations

import math

import pytest

from hil.correction.compensation import Compensation, MotionHistory
from hil.correction.rise import TANH, Rise
from hil.correction.tables import DirectionalTable, SingleTable, TableMode, TableSet
from hil.machine.set_points import CommandState

AMOUNT_UM, LENGTH_MM = 10.0, 0.1


def at_a_turn(*, by_estimate: bool) -> CommandState:
    """After a full stroke in +, at 50 mm; the lost motion alone is in force."""
    nodes = (0.0, 100.0)
    backlash = SingleTable(nodes, [AMOUNT_UM] * 2)  # type: ignore[arg-type]
    zero = DirectionalTable.constant(nodes, 0.0)  # type: ignore[arg-type]
    state = CommandState()
    state.compensation = Compensation(
        TableSet(TableMode.UNIDIRECTIONAL_BACKLASH, zero, backlash), (), Rise(TANH, (AMOUNT_UM,), (LENGTH_MM,))
    )
    state.by_estimate = by_estimate
    state.set_position(MotionHistory(0.0).moved_to(50.0), 50.0)
    return state


def stream(state: CommandState, targets_mm: list[float], behind_mm: float) -> list[float]:
    """Corrections, µm, of a stream whose motor is behind the last command by so much."""
    found, points = [], state.stream({})
    for target_mm in targets_mm:
        command_mm = points.command_mm(target_mm)
        points.issued()
        state.found_at(command_mm + behind_mm)
        found.append(points.correction_um)
    return found


def risen_um(travel_mm: float) -> float:
    return -AMOUNT_UM * math.tanh(travel_mm / LENGTH_MM)


def test_the_rise_follows_the_set_points_or_what_the_encoder_saw_a_cycle_ago() -> None:
    targets = [49.96, 49.92, 49.88, 49.84]
    by_command = stream(at_a_turn(by_estimate=False), targets, 0.03)
    assert by_command == pytest.approx([risen_um(50.0 - t) for t in targets])
    by_estimate = stream(at_a_turn(by_estimate=True), targets, 0.03)
    # the first is of the target itself, as the encoder has not been seen yet; the history begins with it
    assert by_estimate[0] == pytest.approx(risen_um(0.04))
    assert by_estimate[2:] == pytest.approx([risen_um(50.0 - t - 0.0) for t in (49.95, 49.91)], abs=1e-9)


def test_noise_against_the_motion_and_a_correction_not_made_yet_do_not_turn_it() -> None:
    state = at_a_turn(by_estimate=True)
    first, second, third = stream(state, [49.96, 49.92, 49.88], 0.5)  # far behind: no motion was seen
    assert first == second == third == pytest.approx(risen_um(0.04))
    state.command(49.8, {})  # a move from place to place ends the stream
    assert stream(state, [49.84], 0.5)[0] == pytest.approx(risen_um(0.16))
