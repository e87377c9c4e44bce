"""A recording that plays: its values at its times, its gaps, and the files that are none."""

import gzip
from pathlib import Path

import pytest
from support.places import SHARED_DATA as DATA

from drivers.errors import InputError
from drivers.instrument import ReadingStatus
from drivers.instruments.replay import Recording, ReplayInstrument, ReplaySettings
from sim_backends.clock import SimClock

TEXT = (
    "# one\ntime_s,laser_mm,air_temp_c,temp_screw_c\n10.0,1.0,20.0,22\n10.1,1.5,20.1,22\n10.5,,20.2,23\n11.0,2.0,,23\n"
)


def played(path: Path, clock: SimClock, settings: ReplaySettings | None = None) -> ReplayInstrument:
    instrument = ReplayInstrument(Recording.read(path), clock, settings or ReplaySettings())
    instrument.open()
    return instrument


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_values_come_at_their_times(tmp_path: Path, pack: type[bytes]) -> None:
    path = tmp_path / "one.csv"
    path.write_bytes(pack(TEXT.encode()))
    clock = SimClock()
    clock.sleep_s(5.0)
    instrument = played(path, clock, ReplaySettings(direction=-1, speed=2.0))
    assert [reading.position_mm for reading in instrument.poll()] == [-1.0]
    clock.sleep_s(0.1)
    (reading,) = instrument.poll()
    assert (reading.position_mm, reading.time_ns, reading.age_ns(clock.now_ns())) == (-1.5, 5_050_000_000, 50_000_000)
    clock.sleep_s(0.5)
    assert not instrument.over
    lost, last = instrument.poll()
    assert (lost.status, lost.position_mm) == (ReadingStatus.BEAM_LOST, None)
    assert last.position_mm == -2.0
    assert instrument.over
    environment = instrument.environment()
    assert (environment.air_temp_c, environment.place_temps_c) == (None, {"screw": 23.0})
    assert instrument.sample_rate_hz == pytest.approx(6.0)
    clock.sleep_s(10.0)
    assert instrument.poll() == [], "after the last one there are no more: the session calls that stale"


@pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA} (set HIL_SHARED_DATA)")
def test_the_recorded_stage_plays_with_its_43_minutes() -> None:
    clock = SimClock(step_s=1.0)
    recording = Recording.read(DATA / "stage_b02_x_10hz.csv.gz")
    instrument = ReplayInstrument(recording, clock, ReplaySettings(direction=-1))
    instrument.open()
    readings = []
    while not instrument.over:
        clock.sleep_s(10.0)
        readings += instrument.poll()
    assert clock.now_ns() / 60e9 == pytest.approx(43.3, abs=0.2)
    assert len(readings) == len(recording.columns["time_s"]) > 25_000
    assert all(reading.status is ReadingStatus.GOOD for reading in readings)
    assert readings[0].position_mm == -70.089104
    assert readings[-1].position_mm == -68.678240
    assert instrument.sample_rate_hz == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a,b\n1,2\n", r"one\.csv: recording has columns a, b, expected time_s"),
        ("time_s,laser_mm\n", "and rows"),
        ("time_s,laser_mm\n1,2\n1,x\n", r"one\.csv:3: laser_mm is 'x'"),
        ("time_s,laser_mm\n1,2\n1\n", r"one\.csv:3: row has 1 columns"),
        ("time_s,laser_mm\n1,2\n0,2\n", "row 2 was recorded before row 1"),
        ("time_s,laser_mm\n,2\n", "holds something that is no time"),
        ("time_s,other\n1,2\n", "no column laser_mm; it has time_s, other"),
    ],
)
def test_files_that_are_no_recording_are_refused(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "one.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=says):
        played(path, SimClock())


def test_damaged_packing_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "one.csv.gz"
    packed = gzip.compress(TEXT.encode())
    for damaged in (packed[:-12], packed[:15] + b"\xff\xff" + packed[17:], b"\x1f\x8bno"):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"one\.csv\.gz"):
            Recording.read(path)
    with pytest.raises(InputError, match="cannot be read"):
        Recording.read(tmp_path / "nothing.csv")
    with pytest.raises(InputError, match="direction is 2"):
        ReplaySettings(direction=2)
