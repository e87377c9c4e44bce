"""From counts to millimetres: wavelength, air, direction, status, latch, environment."""

import pytest

from drivers.edlen import refractive_index
from drivers.errors import InputError, LinkLostError
from drivers.instrument import ReadingStatus
from drivers.instruments.umd_laser import BesideOptics, FixedAir, Optics, UmdLaser, UmdSettings
from sim_backends.clock import SimClock

VACUUM = UmdSettings(compensate_air=False)
STANDARD = FixedAir(20.0, 1013.25, 50.0)


class Wire:
    """A link that says what it is told to."""

    def __init__(self) -> None:
        self.waiting = b"\n"
        self.open_now = False
        self.gone = False

    def open(self) -> None:
        self.open_now = True

    def close(self) -> None:
        self.open_now = False

    def read_waiting(self) -> bytes:
        if self.gone:
            raise LinkLostError("port test is gone")
        data, self.waiting = self.waiting, b""
        return data

    def say(self, *lines: str) -> None:
        self.waiting += "".join(line + "\r\n" for line in lines).encode()


def laser(settings: UmdSettings) -> tuple[UmdLaser, Wire]:
    wire = Wire()
    instrument = UmdLaser(wire, SimClock(), settings)
    instrument.open()
    return instrument, wire


@pytest.mark.parametrize("optics", list(Optics))
@pytest.mark.parametrize("direction", [1, -1])
def test_displacement_by_optics_and_direction(optics: Optics, direction: int) -> None:
    instrument, wire = laser(UmdSettings(optics=optics, direction=direction, compensate_air=False))
    wire.say("3276 3276 1000000 0 64 1 0 0")
    (reading,) = instrument.poll()
    assert reading.status is ReadingStatus.GOOD
    assert reading.position_mm == pytest.approx(direction * 1000000.25 * 632.9912e-6 / optics, rel=1e-12)


def test_phase_may_have_to_be_subtracted() -> None:
    instrument, wire = laser(UmdSettings(compensate_air=False, phase_sign=-1))
    wire.say("3276 3276 1000 0 64 1 0 0")
    assert instrument.poll()[0].position_mm == pytest.approx(999.75 * 632.9912e-6 / 2)


def test_air_shortens_the_wavelength() -> None:
    instrument, wire = laser(UmdSettings(fixed_air=STANDARD))
    wire.say("3276 3276 1000000 0 0 1 0 0")
    position_mm = instrument.poll()[0].position_mm
    assert position_mm is not None
    assert position_mm == pytest.approx(1e6 * 632.9912e-6 / 2 / 1.000271375, rel=1e-8)


def test_no_position_before_the_air_is_known() -> None:
    instrument, wire = laser(UmdSettings(places={"screw": 4}))
    wire.say("3276 3276 0 0 0 3 3 2000", "3276 3276 0 0 0 4 4 2345", "3276 3276 0 0 0 5 5 101325")
    assert instrument.poll() == []
    assert instrument.environment().air_humidity_percent is None
    wire.say("3276 3276 1000000 0 0 6 6 500", "3276 3276 1000000 0 0 7 8 5000")
    readings = instrument.poll()
    assert [reading.sequence for reading in readings] == [6, 7]
    assert readings[-1].position_mm == pytest.approx(1e6 * 632.9912e-6 / 2 / 1.000271375, rel=1e-8)
    environment = instrument.environment()
    assert (environment.air_temp_c, environment.air_pressure_hpa, environment.air_humidity_percent) == pytest.approx(
        (20.0, 1013.25, 50.0)
    )
    assert environment.place_temps_c == {"screw": pytest.approx(23.45)}
    assert instrument.sample_rate_hz == 50.0


def test_a_bad_signal_is_reported_even_while_the_air_is_unknown() -> None:
    instrument, wire = laser(UmdSettings())
    wire.say("3276 0 0 0 0 1 0 0")
    assert instrument.poll()[0].status is ReadingStatus.BEAM_LOST


def test_a_sensor_that_is_not_fitted_is_none() -> None:
    instrument, wire = laser(UmdSettings(places={"screw": 4}))
    wire.say("3276 3276 0 0 0 3 4 -1", "3276 3276 0 0 0 4 5 101325")
    instrument.poll()
    assert instrument.environment().place_temps_c == {}
    assert instrument.environment().air_temp_c is None
    assert instrument.environment().air_pressure_hpa == pytest.approx(1013.25)


def test_dead_path_is_taken_out() -> None:
    instrument, wire = laser(UmdSettings(dead_path_mm=1000.0, fixed_air=FixedAir(20.0, None, 50.0)))
    unit_mm = 632.9912e-6 / 2
    wire.say("3276 3276 0 0 0 1 5 101325")
    assert instrument.poll()[0].position_mm == pytest.approx(0.0)
    wire.say("3276 3276 0 0 0 2 5 102325")
    instrument.poll()
    before, after = (refractive_index(20.0, hpa, 50.0) for hpa in (1013.25, 1023.25))
    # the reflector did not move, but the air of the dead path became longer optically
    counts = 1000.0 * (after - before) / unit_mm
    wire.say(f"3276 3276 {round(counts)} 0 0 3 0 0")
    assert instrument.poll()[0].position_mm == pytest.approx(0.0, abs=unit_mm)


@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("3276 0 5 0 0 2 0 0", ReadingStatus.BEAM_LOST),
        ("0 0 5 0 0 2 0 0", ReadingStatus.HEAD_ERROR),
        ("3276 7000 5 0 0 2 0 0", ReadingStatus.OVERSPEED),
        ("3276 3276 5 0 0 1 0 0", ReadingStatus.HEAD_ERROR),  # the numbers began anew: so did the count
    ],
)
def test_once_the_count_is_lost_there_is_no_position_until_someone_says_so(line: str, status: ReadingStatus) -> None:
    instrument, wire = laser(VACUUM)
    good = "3276 3276 100 0 0 {} 0 0"
    wire.say(good.format(1), line, good.format(3), good.format(4))
    readings = instrument.poll()
    assert [reading.status for reading in readings] == [ReadingStatus.GOOD, status, *2 * (ReadingStatus.LOST_BEFORE,)]
    assert [reading.position_mm is None for reading in readings] == [False, True, True, True]
    assert instrument.acknowledge_loss()
    wire.say(good.format(5))
    assert instrument.poll()[0].status is ReadingStatus.GOOD


def test_without_the_latch_positions_come_back_by_themselves() -> None:
    instrument, wire = laser(UmdSettings(compensate_air=False, latch_loss=False))
    wire.say("3276 0 0 0 0 1 0 0", "3276 3276 0 0 0 2 0 0")
    assert [reading.status for reading in instrument.poll()] == [ReadingStatus.BEAM_LOST, ReadingStatus.GOOD]


def test_lost_samples_and_bad_lines_are_counted() -> None:
    instrument, wire = laser(VACUUM)
    wire.say("3276 3276 0 0 0 10 0 0", "what?", "3276 3276 0 0 0 14 0 0")
    assert [reading.lost_before for reading in instrument.poll()] == [0, 3]
    assert instrument.bad_lines == 1


def test_axis_that_is_not_on_the_line_is_a_head_error() -> None:
    instrument, wire = laser(UmdSettings(compensate_air=False, axis=2))
    wire.say("3276 3276 0 0 0 1 0 0")
    assert instrument.poll()[0].status is ReadingStatus.HEAD_ERROR


def test_angle_optics_on_the_other_axes() -> None:
    beside = {"pitch_urad": BesideOptics(2, 3.2), "yaw_urad": BesideOptics(3, -1.6)}
    instrument, wire = laser(UmdSettings(compensate_air=False, beside=beside))
    wire.say("3276 3276 10 0 0 9 0 0 3277 20 1 64 3270 30 0 384")
    assert [reading.status for reading in instrument.poll()] == [ReadingStatus.GOOD]
    assert instrument.environment().beside == pytest.approx({"pitch_urad": 20.25 * 3.2, "yaw_urad": -29.5 * 1.6})
    wire.say("3276 3276 10 0 0 10 0 0 3277 20 1 64 0 30 0 384")
    assert instrument.poll()[0].status is ReadingStatus.GOOD, "the position does not suffer"
    assert instrument.environment().beside.keys() == {"pitch_urad"}
    wire.say("3276 3276 10 0 0 11 0 0")
    instrument.poll()
    assert instrument.environment().beside == {}


def test_a_port_that_was_away_took_the_zero_with_it() -> None:
    """The display is fed by it: the count may be a new one, whatever its sequence numbers say."""
    instrument, wire = laser(VACUUM)
    wire.say("3276 3276 100 0 0 1 0 0")
    instrument.poll()
    wire.gone = True
    with pytest.raises(LinkLostError):
        instrument.poll()
    wire.gone = False
    wire.say("276 100 0 0 2 0 0", "3276 3276 100 0 0 3 0 0")
    assert [reading.status for reading in instrument.poll()] == [ReadingStatus.LOST_BEFORE]
    assert instrument.bad_lines == 1, "joined in mid-line again"
    instrument.acknowledge_loss()
    wire.say("3276 3276 100 0 0 4 0 0")
    assert instrument.poll()[0].status is ReadingStatus.GOOD


def test_a_reading_is_no_older_than_the_look_before() -> None:
    wire, clock = Wire(), SimClock()
    instrument = UmdLaser(wire, clock, VACUUM)
    instrument.open()
    instrument.poll()
    clock.sleep_s(0.2)
    wire.say("3276 3276 100 0 0 1 0 0", "3276 3276 100 0 0 2 0 0")
    assert [(reading.since_ns, reading.time_ns) for reading in instrument.poll()] == [(0, 200_000_000)] * 2
    clock.sleep_s(60.0)
    wire.say("3276 3276 100 0 0 3 0 0")
    assert instrument.poll()[0].age_ns(clock.now_ns()) == 60_000_000_000, "how long it lay in the port, nobody knows"


def test_a_lost_link_is_an_error() -> None:
    instrument, wire = laser(VACUUM)
    wire.gone = True
    with pytest.raises(LinkLostError):
        instrument.poll()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"direction": 0}, "direction is 0"),
        ({"axis": 4}, "axis is 4"),
        ({"vacuum_wavelength_nm": 0.633}, "vacuum_wavelength_nm"),
        ({"beside": {"pitch_urad": BesideOptics(1, 1.0)}}, "axis of pitch_urad is 1"),
        ({"places": {"screw": 5}}, "channel of screw"),
        ({"places": {"screw": 3}}, "named for the air and for screw"),
    ],
)
def test_settings_that_cannot_be_are_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        UmdSettings(**wrong)  # type: ignore[arg-type]
