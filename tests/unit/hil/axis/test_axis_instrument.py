"""The [instrument] section by kind: what is read, what is refused, and that the instrument it describes can be made."""

from pathlib import Path

import pytest
from support.bench_axis import lay_out
from support.toy_axis import ToyMachine, toy_session

from drivers.errors import InputError
from drivers.instrument import Environment
from drivers.instruments.gauge import Gauge
from drivers.instruments.replay import ReplayInstrument
from drivers.instruments.umd_laser import BesideOptics, UmdLaser
from hil.app.main import main
from hil.axis.axis_file import AxisConfig, load_axis
from hil.axis.identity import instrument_identity
from hil.axis.instrument import KINDS
from hil.machine.instruments import build_instrument
from hil.machine.simulated_file import instrument_text
from sim_backends import GAUGE_KINDS
from sim_backends.clock import SimClock

RECORDING = "time_s,laser_mm\n0,1\n1,2\n"
SECTIONS = {
    "umd": 'kind = "umd"\nresume_within_s = 30',
    "nd2xx": 'kind = "nd2xx"\ncount_mm = 0.0001\nbaud = 19200',
    "ascii": 'kind = "ascii"\npattern = "mitutoyo"\nfault = "9.."\nunit = "in"\ndecimals = 5\nrequest = "1\\r"\ndirection = -1',
    "replay": 'kind = "replay"\nfile = "r.csv"\ncolumn = "laser_mm"\nspeed = 10',
}


def axis_with(directory: Path, section: str) -> AxisConfig:
    path = lay_out(directory)
    path.write_text(path.read_text().replace("place_temps = { screw = 4 }", section))
    return load_axis(path)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_is_read_made_and_named(tmp_path: Path, kind: str) -> None:
    (tmp_path / "r.csv").write_text(RECORDING)
    axis = axis_with(tmp_path, SECTIONS[kind])
    assert axis.instrument.kind == kind
    made = build_instrument(axis.instrument, "/dev/nothing", SimClock())
    assert isinstance(made, UmdLaser if kind == "umd" else ReplayInstrument if kind == "replay" else Gauge)
    identity = " ".join(instrument_identity(axis.instrument).values())
    assert {"umd": "µMD", "nd2xx": "ND 2xx", "ascii": "mitutoyo", "replay": "r.csv"}[kind] in identity
    purpose = axis.purpose("calibrate")["instrument"]
    assert purpose["kind"] == kind
    assert "resume_within_s" not in purpose, "how long one waits does not decide what is measured"


def test_optics_beside_the_position_reach_the_rows(tmp_path: Path) -> None:
    axis = axis_with(tmp_path, "beside = { yaw_urad = { axis = 3, per_unit = -1.6 } }")
    made = build_instrument(axis.instrument, "/dev/nothing", SimClock())
    assert isinstance(made, UmdLaser)
    assert made.settings.beside == {"yaw_urad": BesideOptics(3, -1.6)}
    session = toy_session(ToyMachine())
    session.instrument.environment = lambda: Environment(0, beside={"yaw_urad": 4.5})  # type: ignore[method-assign]
    assert session.known()["yaw_urad"] == 4.5


def test_a_display_s_keys_arrive(tmp_path: Path) -> None:
    display = axis_with(tmp_path / "a", SECTIONS["ascii"]).instrument.display
    assert display is not None
    assert (display.unit, display.decimals, display.request, display.parity) == ("in", 5, "1\r", "N")
    for written, unit in (("MM", "mm"), ("Inch", "inch"), ("µM", "μm")):
        other = axis_with(tmp_path / unit, SECTIONS["ascii"].replace('"in"', f'"{written}"')).instrument.display
        assert other is not None
        assert other.unit == unit
    config = axis_with(tmp_path / "n", SECTIONS["nd2xx"]).instrument
    assert config.display is not None
    assert (config.display.baud, config.display.data_bits, config.display.parity) == (19200, 7, "E")


@pytest.mark.parametrize(
    ("section", "says"),
    [
        ('kind = "yardstick"', "expected umd, nd2xx, ascii or replay"),
        ('kind = "nd2xx"\nplace_temps = { screw = 4 }', "unknown key place_temps"),
        ('kind = "nd2xx"\ncount_mm = 0', "count_mm is 0"),
        ('kind = "ascii"\nparity = "X"', "parity is X"),
        ('kind = "ascii"', r"\[instrument\] lacks pattern, expected number, mitutoyo, .* such as .*\(\?P<value>"),
        (
            'kind = "ascii"\npattern = "x+"',
            r"\[instrument\] pattern is 'x\+' and has no group .* such as .*\(\?P<value>",
        ),
        ('kind = "ascii"\npattern = "(?P<value>"', r"pattern is .* no regular expression: .* such as .*\(\?P<value>"),
        ('kind = "ascii"\npattern = "(?P<wert>.*)"', r"pattern is .* has no group for the number"),
        (
            'kind = "ascii"\npattern = "number"\nfault = "*"',
            r"\[instrument\] fault is '\*', which is no regular expression",
        ),
        ('kind = "replay"', "lacks file"),
        ('kind = "replay"\nfile = "r.csv"\nport = "x"', "unknown key port"),
        (
            "beside = { pitch_urad = { axis = 1, per_unit = 3.2 } }",
            "beside gives an axis twice, or the position's own, 1",
        ),
        (
            "beside = { pitch_urad = { axis = 2 } }",
            r"\[instrument.beside.pitch_urad\] lacks per_unit, expected a number",
        ),
        ("beside = 3", "beside is 3"),
        ("resume_within_s = 0", "resume_within_s is 0"),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(tmp_path: Path, section: str, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        axis_with(tmp_path, section)
    assert caught.value.line is not None


def test_a_recording_that_is_missing_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    axis = axis_with(tmp_path, 'kind = "replay"\nfile = "none.csv"')
    assert main(["doctor", str(axis.path)]) == 2
    assert "none.csv: cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["umd", *GAUGE_KINDS])
def test_the_simulated_machine_s_own_section_is_read_back(tmp_path: Path, kind: str) -> None:
    config = axis_with(tmp_path, instrument_text(kind, "/dev/pts/9")).instrument
    assert config.port == "/dev/pts/9"
    assert isinstance(build_instrument(config, config.port, SimClock()), UmdLaser if kind == "umd" else Gauge)
