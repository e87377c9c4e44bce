"""Faults as data: in force when they should be, single ones exactly once."""

import math

from sim_backends.faults import Fault, FaultKind, FaultSchedule

ONCE = Fault(FaultKind.GLITCH, at_s=2.0, size=5.0)
LONG = Fault(FaultKind.BEAM_LOST, at_s=1.0, duration_s=3.0)


def test_a_lasting_fault_is_in_force_from_its_beginning_to_before_its_end() -> None:
    schedule = FaultSchedule([LONG])
    assert [schedule.active(t) == [LONG] for t in (0.99, 1.0, 3.99, 4.0)] == [False, True, True, False]


def test_a_single_fault_comes_exactly_once_however_late_one_looks() -> None:
    schedule = FaultSchedule([ONCE, LONG])
    assert schedule.active(1.5) == [LONG]
    assert schedule.active(2.7) == [LONG, ONCE]
    assert schedule.active(2.8) == [LONG]


def test_next_change() -> None:
    schedule = FaultSchedule([ONCE, LONG])
    assert [schedule.next_change_s(t) for t in (0.0, 1.0, 2.0, 4.0)] == [1.0, 2.0, 4.0, math.inf]
    assert FaultSchedule().next_change_s(0.0) == math.inf


def test_faults_that_are_added_while_it_runs_happen_beside_those_before() -> None:
    schedule = FaultSchedule([Fault(FaultKind.RESTART, 1.0), Fault(FaultKind.BEAM_LOST, 5.0, 1.0)])
    assert [fault.kind for fault in schedule.active(2.0)] == [FaultKind.RESTART]
    schedule.add([Fault(FaultKind.RESTART, 0.5), Fault(FaultKind.JAM, 2.5, 3.0)])
    assert [fault.at_s for fault in schedule.active(3.0)] == [0.5, 2.5], "the earlier one is over, the added ones begin"
    assert [fault.kind for fault in schedule.active(5.2)] == [FaultKind.JAM, FaultKind.BEAM_LOST]
