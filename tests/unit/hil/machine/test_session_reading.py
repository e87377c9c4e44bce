"""Reading at a target: nothing from before the arrival, nothing while the load creeps, and a port that went is a lost measurement."""

# ruff: noqa: PT012 - leaving the session is part of what raises, so whole sessions stand under raises()
from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from support.toy_axis import OFFSET_MM, ToyInstrument, ToyMachine, toy_session

from drivers.clock import NS_PER_S
from drivers.errors import LinkLostError, MeasurementLostError, MotionTimeoutError
from drivers.instrument import Reading
from hil.machine.session import AxisSession


def reading_by(session: AxisSession, change: Callable[[Sequence[Reading]], Sequence[Reading]]) -> None:
    """From now on the instrument's readings pass through `change`."""
    instrument = session.instrument
    assert isinstance(instrument, ToyInstrument)
    plain = instrument.poll
    instrument.poll = lambda: change(plain())  # type: ignore[method-assign]


def test_a_reading_that_may_be_from_before_the_arrival_is_not_used() -> None:
    machine = ToyMachine(play_mm=0.0, wave_um=0.0)
    with toy_session(machine, dwell_s=0.0, reading_s=0.2) as session:
        session.prepare()
        session.move_to(30.0)
        arrived_ns = machine.clock.now_ns()

        def old_first(readings: Sequence[Reading]) -> Sequence[Reading]:
            """What waited on the line, with a value of the way."""
            return [
                replace(r, position_mm=OFFSET_MM + 25.0, since_ns=arrived_ns - 1)
                if r.time_ns < arrived_ns + 0.15e9
                else r
                for r in readings
            ]

        reading_by(session, old_first)
        assert session.read_position().position_load_mm == pytest.approx(30.0, abs=1e-9)


def test_old_readings_alone_are_none() -> None:
    machine = ToyMachine()
    with pytest.raises(MeasurementLostError, match="no reading in"), toy_session(machine) as session:
        session.prepare()
        session.move_to(30.0)
        reading_by(session, lambda readings: [replace(r, since_ns=0) for r in readings])
        session.read_position()


@pytest.mark.parametrize(("seconds", "settles"), [(2.0, True), (30.0, False)])
def test_a_load_that_creeps_is_waited_for_up_to_a_time(seconds: float, settles: bool) -> None:
    machine = ToyMachine(play_mm=0.0, wave_um=0.0)
    with toy_session(machine, settle_um=0.1, settle_within_s=5.0, reading_s=0.3) as session:
        session.prepare()
        session.move_to(30.0)
        arrived_ns = machine.clock.now_ns()

        def creeping(readings: Sequence[Reading]) -> Sequence[Reading]:
            return [
                replace(
                    r,
                    position_mm=(r.position_mm or 0.0)
                    + 0.01 * math.exp(-(r.time_ns - arrived_ns) / NS_PER_S / seconds * 4),
                )
                for r in readings
            ]

        reading_by(session, creeping)
        if settles:
            assert session.read_position().position_load_mm == pytest.approx(30.0, abs=0.0003)
            assert machine.clock.now_ns() - arrived_ns > 1.0e9
        else:
            with pytest.raises(MotionTimeoutError, match=r"still moves by -\d\.\d+ ± \d\.\d+ µm \(k = 2\) in 0.3 s"):
                session.read_position()


def test_a_glitch_is_left_out_of_the_average() -> None:
    machine = ToyMachine(play_mm=0.0, wave_um=0.0)
    with toy_session(machine, reading_s=0.3) as session:
        session.prepare()
        session.move_to(30.0)
        reading_by(
            session,
            lambda rs: [replace(r, position_mm=(r.position_mm or 0.0) + 0.4 * (r.sequence % 25 == 0)) for r in rs],
        )
        got = session.read_position()
        assert got.position_load_mm == pytest.approx(30.0, abs=1e-9)
        assert got.left_out in (1, 2)
        assert got.count + got.left_out == 30


def test_a_port_of_the_instrument_that_went_away_is_a_lost_measurement() -> None:
    machine = ToyMachine()

    def gone(readings: Sequence[Reading]) -> Sequence[Reading]:
        raise LinkLostError("port test is gone")

    with pytest.raises(MeasurementLostError, match="toy gauge: port test is gone"), toy_session(machine) as session:
        session.prepare()
        reading_by(session, gone)
        session.move_to(30.0)
    assert machine.told("quick stop")


def test_an_instrument_that_answers_when_asked_is_looked_at_more_often() -> None:
    looks = []
    for asked in (False, True):
        machine = ToyMachine()
        with toy_session(machine) as session:
            session.instrument.answers_when_asked = asked
            before = machine.counted
            session.watch(1.0)
            looks.append(machine.counted - before)
    assert looks[1] == 4 * looks[0]
