"""From an axis file to drive and instrument: every face shows the same machine, every setting arrives, every mistake is named."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import bench_axis
from support.served_drive import served

from drivers.canopen.drive import CanOpenDrive, CanOpenSettings, HomingSettings
from drivers.clock import WallClock
from drivers.drive import Capability
from drivers.errors import InputError, LinkLostError, MeasurementLostError
from drivers.instruments.umd_laser import FixedAir, Optics, UmdLaser, UmdSettings
from drivers.modbus.drive import ModbusDrive
from hil.axis.agreement import AgreementLimits
from hil.axis.axis_file import AxisConfig, load_axis
from hil.calibration.calibrate import calibrate
from hil.correction.tables import TableSet
from hil.machine.axis_lock import drive_address, held_axis
from hil.machine.bench_wiring import bench_parameters, running_bench
from hil.machine.wiring import connected, connected_drive
from hil.parameters.wiring import connected_parameters
from hil.records.journal import Campaign
from sim_backends.bare_shaft import BareShaft
from sim_backends.faults import Fault, FaultKind
from sim_backends.servo import SimulatedServo
from sim_backends.virtual_drive import VirtualDrive

FACES = {
    "canopen": (CanOpenDrive, 'face = "canopen"'),
    "virtual": (VirtualDrive, 'face = "virtual"'),
    "modbus-tcp": (ModbusDrive, 'face = "modbus-tcp"'),
    "modbus-rtu": (ModbusDrive, 'face = "modbus-rtu"'),
    "modbus-tcp, vendor": (ModbusDrive, 'face = "modbus-tcp"\nregister_map = "vendor_style"'),
    "modbus-rtu, vendor": (ModbusDrive, 'face = "modbus-rtu"\nregister_map = "vendor_style"'),
}
SAME_TABLE_UM = 0.1
"""The laser's noise at rest (0.03 µm a reading, 30 averaged) and where in its window a drive settles; tables are up to 20 µm."""

LayOut = Callable[..., AxisConfig]


@pytest.fixture
def lay_out(tmp_path: Path) -> LayOut:
    """lay_out(drive, instrument): an axis on the bench with these lines more in its sections."""

    def write(drive: str = "", instrument: str = "") -> AxisConfig:
        path = bench_axis.lay_out(tmp_path, sections=4, runs=2)
        text = path.read_text(encoding="utf-8").replace("[drive]\n", f"[drive]\n{drive}\n")
        path.write_text(text.replace("[instrument]\n", f"[instrument]\n{instrument}\n"), encoding="utf-8")
        return load_axis(path)

    return write


def on_hardware(path: Path, drive: str, port: str = "/nowhere") -> AxisConfig:
    """The same axis on a real drive."""
    text = bench_axis.lay_out(path, sections=4).read_text(encoding="utf-8")
    text = text.replace('backend = "bench"\nmachine = "geometric"\nseed = 5', drive)
    (path / "axis.toml").write_text(
        text.replace("[instrument]\n", f'[instrument]\nport = "{port}"\n'), encoding="utf-8"
    )
    return load_axis(path / "axis.toml")


def tables_of(axis: AxisConfig, kind: type) -> TableSet:
    with connected(axis) as machine:
        assert isinstance(machine.session.drive, kind)
        machine.session.prepare()
        campaign = Campaign.numbered(axis.store.directory, axis.purpose("calibrate"), resume=False)
        return calibrate(machine.session, campaign, axis.correction, lambda _tables: None).tables


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory) -> TableSet:
    return tables_of(
        load_axis(bench_axis.lay_out(tmp_path_factory.mktemp("canopen"), sections=4, runs=2)), CanOpenDrive
    )


@pytest.mark.parametrize("face", ["virtual", pytest.param("modbus-rtu, vendor", marks=pytest.mark.outside)])
def test_a_calibration_over_any_face_gives_the_same_tables(face: str, lay_out: LayOut, expected: TableSet) -> None:
    kind, lines = FACES[face]
    tables = tables_of(lay_out(lines), kind)
    assert np.ptp([expected.pitch.plus_um, expected.pitch.minus_um]) > 10.0, "an axis with something to correct"
    assert np.array_equal(tables.pitch.position_mm, expected.pitch.position_mm)
    for direction in ("plus_um", "minus_um"):
        assert np.abs(getattr(tables.pitch, direction) - getattr(expected.pitch, direction)).max() < SAME_TABLE_UM


@pytest.mark.parametrize("face", FACES)
def test_the_drive_alone_can_be_had_without_an_instrument(face: str, lay_out: LayOut) -> None:
    kind, lines = FACES[face]
    with connected_drive(lay_out(lines)) as drive:
        assert isinstance(drive, kind)
        drive.require(Capability.PROFILE_POSITION)
        assert drive.sample().position_load_mm == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize("face", ["canopen", "virtual"])
def test_the_homing_asked_for_is_the_homing_done(face: str, lay_out: LayOut) -> None:
    """The home switch is at -2 mm of the machine (its own frame); called +1 mm, the whole axis is shifted by 3 mm."""
    homing = "homing = { method = 21, speed_switch_mm_s = 15.0, speed_zero_mm_s = 0.5, home_position_mm = 1.0 }"
    axis = lay_out(f'face = "{face}"\n{homing}')
    with connected(axis) as machine:
        machine.session.prepare()
        assert machine.bench is not None
        shown, reference_mm = machine.session.drive.sample().position_load_mm, axis.measurement.reference_mm
        assert shown == pytest.approx(reference_mm, abs=0.01)
        assert machine.bench.plant.position_mm == pytest.approx(reference_mm - 3.0, abs=0.05)


def test_a_canopen_drive_in_real_time_with_its_settings(tmp_path: Path) -> None:
    """The same way as to a drive on a machine, over python-can's virtual bus."""
    channel = f"wiring-{tmp_path}"
    drive = f'backend = "canopen"\ninterface = "virtual"\nchannel = "{channel}"\nnode_id = 9'
    times = "sdo_timeout_s = 1.25\nsample_timeout_s = 0.75\nheartbeat_s = 0\nguard_s = 3"
    axis = on_hardware(tmp_path, f"{drive}\n{times}\nhoming = {{ method = 35, home_position_mm = 2.5 }}")
    with served(SimulatedServo(BareShaft()), WallClock(), channel=channel, node_id=9), connected_drive(axis) as drive_9:
        assert isinstance(drive_9, CanOpenDrive)
        assert drive_9.node_id == 9
        assert drive_9.settings == CanOpenSettings(
            sdo_timeout_s=1.25,
            sample_timeout_s=0.75,
            heartbeat_s=None,
            guard_s=3.0,
            homing=HomingSettings(35, None, None, 2.5),
        )


@pytest.mark.parametrize(("line", "guard_s"), [("", 2.0), ("guard_s = 0.5", 0.5), ("guard_s = 0", None)])
def test_a_drive_on_a_machine_watches_its_master_unless_told_not_to(
    line: str, guard_s: float | None, tmp_path: Path
) -> None:
    drive = f'backend = "canopen"\ninterface = "virtual"\nchannel = "guard-{tmp_path}"\nnode_id = 9\n{line}'
    assert on_hardware(tmp_path, drive).drive.guard_s == guard_s


def test_the_instruments_settings_arrive(lay_out: LayOut) -> None:
    axis = lay_out(
        instrument="wavelength_fraction = 4\ndirection = -1\nphase_sign = -1\naxis = 2\ndead_path_mm = 250\n"
        "vacuum_wavelength_nm = 632.9\nfixed_air = { temp_c = 21.5, pressure_hpa = 990.0 }"
    )
    with connected(axis) as machine:
        instrument = machine.session.instrument
        assert isinstance(instrument, UmdLaser)
        assert instrument.settings == UmdSettings(
            optics=Optics.PLANE_MIRROR,
            vacuum_wavelength_nm=632.9,
            direction=-1,
            phase_sign=-1,
            axis=2,
            fixed_air=FixedAir(21.5, 990.0, None),
            places={"screw": 4},
            dead_path_mm=250.0,
        )


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("tcp://", "lacks a host"),
        ("udp://10.0.0.1:502", "expected tcp://host:port or a serial device"),
        ("tcp://10.0.0.1:99999", "port is not a number"),
        ("/dev/ttyUSB1?parity=X", "parity is 'X'"),
        ("/dev/ttyUSB1?speed=9600", "unknown option speed"),
    ],
)
def test_a_wrong_address_is_named_with_its_file(url: str, words: str, tmp_path: Path) -> None:
    axis = on_hardware(tmp_path, f'backend = "modbus"\nregister_map = "vendor_style"\nurl = "{url}"')
    with pytest.raises(InputError, match=r"axis\.toml: \[drive\] url: ") as caught, connected(axis):
        pass
    assert words in str(caught.value)


def test_a_missing_register_map_is_named(tmp_path: Path) -> None:
    axis = on_hardware(tmp_path, 'backend = "modbus"\nregister_map = "mine.toml"\nurl = "tcp://127.0.0.1"')
    with pytest.raises(InputError, match=r"mine\.toml: is neither a file nor a shipped register map"), connected(axis):
        pass


def test_a_drive_that_is_not_there_is_a_lost_link(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    axis = on_hardware(
        tmp_path, f'backend = "modbus"\nregister_map = "vendor_style"\nurl = "tcp://127.0.0.1:{port}?timeout_s=0.5"'
    )
    with pytest.raises(LinkLostError, match=f"127.0.0.1:{port} cannot be opened"), connected(axis):
        pass
    axis = on_hardware(
        tmp_path / "can", 'backend = "canopen"\ninterface = "slcan"\nchannel = "/dev/nowhere"\nnode_id = 3'
    )
    with pytest.raises(LinkLostError, match="CAN slcan /dev/nowhere cannot be opened"), connected(axis):
        pass


def test_an_axis_that_is_not_the_benchs_is_refused(lay_out: LayOut, tmp_path: Path) -> None:
    path = lay_out().path
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("feed_mm_per_shaft_rev = 10.0", "feed_mm_per_shaft_rev = 5.0"), encoding="utf-8")
    with pytest.raises(InputError, match="feed_mm_per_shaft_rev = 10"), connected(load_axis(path)):
        pass
    path.write_text(text.replace("travel_max_mm = 502.0", "travel_max_mm = 600.0"), encoding="utf-8")
    with pytest.raises(InputError, match="exceeds the bench's"), connected_drive(load_axis(path)):
        pass


def test_an_axis_is_connected_once_at_a_time(tmp_path: Path) -> None:
    axis = load_axis(bench_axis.lay_out(tmp_path))
    with connected(axis):
        for again in (connected, connected_drive):
            with pytest.raises(InputError, match=r"axis\.toml: is in use already, expected one process"), again(axis):
                pass
    with connected_drive(axis):
        pass


def test_an_axis_file_that_is_replaced_meanwhile_is_still_in_use(tmp_path: Path) -> None:
    """As `sed -i` and editors do it: another file takes the name."""
    axis = load_axis(bench_axis.lay_out(tmp_path))
    with connected(axis):
        new = axis.path.with_suffix(".new")
        new.write_bytes(axis.path.read_bytes())
        new.replace(axis.path)
        with pytest.raises(InputError, match="is in use already"), connected(axis):
            pass
    with connected(axis):
        pass


PLACES = {
    "can": 'backend = "canopen"\ninterface = "{bus}"\nchannel = "{can}"\nnode_id = {unit}',
    "tcp": 'backend = "modbus"\nregister_map = "cia402_over_modbus"\nurl = "tcp://{host}:{port}"\nunit = {unit}',
    "serial": 'backend = "modbus"\nregister_map = "cia402_over_modbus"\nurl = "{device}"\nunit = {unit}',
}


@pytest.mark.outside
@pytest.mark.parametrize("kind", PLACES)
@pytest.mark.parametrize("face", ["copy", "other name of the place", "other unit"])
def test_a_drive_is_held_whichever_axis_file_names_it(tmp_path: Path, kind: str, face: str) -> None:
    """A copied axis file, perhaps with another store, is another file and the same drive."""
    device, link = tmp_path / "ttyUSB0", tmp_path / "by-id"
    device.touch()
    link.symlink_to(device)
    here = {"bus": "slcan", "can": str(device), "host": "127.0.0.1", "port": 5020, "device": str(device), "unit": 3}
    there = here | {
        "copy": {},
        "other name of the place": {"can": f"{link}@115200", "host": "localhost", "device": f"rtu:{link}?timeout_s=2"},
        "other unit": {"unit": 4},
    }[face]  # fmt: skip
    text = PLACES[kind]
    axes = [on_hardware(tmp_path / name, text.format(**values)) for name, values in (("one", here), ("two", there))]
    with held_axis(axes[0]):
        if face == "other unit":
            with held_axis(axes[1]):
                return
        said = r"two/axis\.toml: its drive \(.*(node|unit) 3\) is in use already, by another axis file"
        for connect in (held_axis, connected, connected_drive, lambda axis: connected_parameters([axis])):
            with pytest.raises(InputError, match=said), connect(axes[1]):
                pass
        other = "import sys, hil; hil.open(sys.argv[1]).__enter__()"
        done = subprocess.run([sys.executable, "-c", other, axes[1].path], check=False, capture_output=True, text=True)
        assert "is in use already, by another axis file" in done.stderr
    with held_axis(axes[1]):
        pass


def test_the_benchs_drive_has_no_place_that_another_could_reach(tmp_path: Path) -> None:
    one, two = (load_axis(bench_axis.lay_out(tmp_path / name)) for name in ("one", "two"))
    assert drive_address(one) is None
    with connected_drive(one), connected_drive(two):
        pass


@pytest.mark.parametrize(("within_um", "good"), [(4000.0, True), (500.0, False), (50.0, False)])
def test_what_the_instrument_may_differ_by_comes_from_the_axis_file(
    within_um: float, good: bool, lay_out: LayOut
) -> None:
    """A reading that is 0.3 mm beside the others for a second, at rest."""
    axis = lay_out('face = "virtual"', f"instrument_agrees_within_um = {within_um}\nlatency_s = 0.01")
    text = axis.path.read_text(encoding="utf-8").replace("[axis]\n", "[axis]\nlargest_reversal_um = 20.0\n")
    axis.path.write_text(text, encoding="utf-8")
    axis = load_axis(axis.path)
    assert axis.agreement == AgreementLimits(within_um, 20.0, 0.01)
    faults = (Fault(FaultKind.GLITCH, at_s=25.0, duration_s=1.0, size=300.0),)
    wanted = replace(bench_parameters(axis), laser_faults=faults)
    with running_bench([axis], [wanted]) as running, connected(axis, running) as machine:
        machine.session.prepare()
        assert machine.session.elapsed_s() < 24.0
        beside = nullcontext() if good else pytest.raises(MeasurementLostError, match=r"jumped by 0\.3")
        with beside:
            machine.session.watch(30.0 - machine.session.elapsed_s())
