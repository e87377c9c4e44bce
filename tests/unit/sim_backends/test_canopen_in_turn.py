"""Drives without a thread on python-can's virtual bus: seen by any bus on the channel, answering when they are looked for."""

import uuid

import can

from sim_backends.canopen_in_turn import drives_in_turn
from sim_backends.clock import SimClock
from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.parameters import ideal_axis
from sim_backends.servo import SimulatedServo

READ_DEVICE_TYPE = bytes.fromhex("4000100000000000")
DEVICE_TYPE = bytes.fromhex("4300100092010200")  # CiA-402, servo drive


def test_two_drives_answer_and_a_third_party_sees_it() -> None:
    clock = SimClock()
    channel = uuid.uuid4().hex
    with (
        drives_in_turn(clock, channel) as bus,
        can.Bus(interface="virtual", channel=channel) as listener,
        bus.master() as master,
    ):
        for node_id in (3, 4):
            servo = SimulatedServo(FeedAxis(ideal_axis()))
            clock.attach(servo.advance, bearable=servo.bearable)
            bus.add(servo, node_id)
        for node_id in (3, 4):
            master.send(can.Message(arbitration_id=0x600 + node_id, data=READ_DEVICE_TYPE, is_extended_id=False))
        answers = {}
        while (message := master.recv(1.0)) is not None:
            answers[message.arbitration_id] = bytes(message.data)
        assert (answers[0x583], answers[0x584]) == (DEVICE_TYPE, DEVICE_TYPE)
        seen = set()
        while (message := listener.recv(0.0)) is not None:
            seen.add(message.arbitration_id)
        assert {0x603, 0x604, 0x583, 0x584} <= seen


def test_time_that_passes_lets_a_drive_speak_by_itself() -> None:
    clock = SimClock()
    channel = uuid.uuid4().hex
    with drives_in_turn(clock, channel) as bus, bus.master() as master:
        servo = SimulatedServo(FeedAxis(ideal_axis()))
        clock.attach(servo.advance, bearable=servo.bearable)
        bus.add(servo, 3, parameters={(0x1017, 0): 100})
        clock.sleep_s(1.05)
        beats = 0
        while (message := master.recv(1.0)) is not None:
            beats += message.arbitration_id == 0x703
        assert 10 <= beats <= 12  # with the boot-up
    clock.sleep_s(1.0)  # nobody is left on the bus, and nothing happens
