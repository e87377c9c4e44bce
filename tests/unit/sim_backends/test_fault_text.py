"""Faults as they are typed, and when they are in force."""

from __future__ import annotations

import math

import pytest

from drivers.errors import InputError
from sim_backends.canopen_faults import CanFault
from sim_backends.fault_text import Faults, parse_faults
from sim_backends.faults import CanFaultKind, Fault, FaultKind, FaultSchedule, WireFaultKind, fault_names
from sim_backends.modbus_faults import WireFault


def test_each_goes_to_the_part_that_it_happens_to() -> None:
    assert parse_faults(["beam-lost@20+3", "drive-fault@12=0x8611", "jam@1.5+0.2"]) == Faults(
        laser=(Fault(FaultKind.BEAM_LOST, 20.0, 3.0),),
        servo=(Fault(FaultKind.DRIVE_FAULT, 12.0, 0.0, 0x8611), Fault(FaultKind.JAM, 1.5, 0.2)),
    )
    assert parse_faults(["heartbeat-stops@30", "sdo-late@10+1=0.7"], wire=CanFaultKind).can == (
        CanFault(CanFaultKind.HEARTBEAT_STOPS, 30.0),
        CanFault(CanFaultKind.SDO_LATE, 10.0, 1.0, 0.7),
    )
    assert parse_faults(["no-reply#5*2", "late-reply#9=0.3"], wire=WireFaultKind).modbus == (
        WireFault(WireFaultKind.NO_REPLY, 5, 2),
        WireFault(WireFaultKind.LATE_REPLY, 9, delay_s=0.3),
    )


def test_every_kind_can_be_typed() -> None:
    machine = parse_faults([f"{name}@1" for name in fault_names(FaultKind)])
    assert len(machine.laser) + len(machine.servo) == len(FaultKind)
    bus = parse_faults([f"{name}@1" for name in fault_names(CanFaultKind)], wire=CanFaultKind)
    assert {fault.kind for fault in bus.can} | {CanFaultKind.DRIVE_FAULT} == set(CanFaultKind)
    wire = parse_faults([f"{name}#1" for name in fault_names(WireFaultKind)], wire=WireFaultKind)
    assert [fault.kind for fault in wire.modbus] == list(WireFaultKind)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "expected KIND@"),
        ("beam-lost@", "expected KIND@"),
        ("beam lost@2", "expected KIND@"),
        ("beam-lost@1.2.3", "no number"),
        ("bean-lost@1", "unknown kind bean-lost, expected one of beam-lost"),
        ("beam-lost#3", "takes a time"),
        ("sdo-late@1", "unknown kind sdo-late"),
    ],
)
def test_what_cannot_be_understood_is_named(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_faults([text])


def test_a_fault_of_the_wire_is_counted_in_requests() -> None:
    with pytest.raises(InputError, match="takes a request's number"):
        parse_faults(["no-reply@4"], wire=WireFaultKind)


# -- when they are in force ----------------------------------------------------------------------------------------
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
