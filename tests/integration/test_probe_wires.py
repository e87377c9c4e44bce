"""The same procedure over CANopen and Modbus: the same contacts as without a wire, and what a drive cannot do said before it moves."""

from __future__ import annotations

import uuid
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest
from support import probe_files
from support.probe_files import connected_probe
from support.served_drive import served

from drivers.clock import WallClock
from drivers.drive import ServoDrive
from drivers.errors import CapabilityError
from drivers.modbus.drive import ModbusDrive
from hil.axis.axis_file import load_drive_axis
from hil.machine.links import Links
from hil.machine.wiring import hardware_drive
from hil.probe.machine_file import load_probe_machine
from hil.probe.procedure import measure_run_out
from hil.probe.wiring import probe_bench, probe_session
from sim_backends.plant.touch_probe import Bore, Face, Stylus
from sim_backends.probe import ProbeParameters

STYLUS = Stylus(2.0, (0.008, -0.004))
TRUTH = ProbeParameters(STYLUS, (Face((105.0, 40.0, 0.0)), Bore((50.05, 59.98, 0.0), 2.5)))
FAST = "velocity_deg_s = 360.0"


def lay_out(tmp_path: Path, drive: str, mode: str, **more: str) -> Path:
    """Close to the face by pulses, each of which takes several requests."""
    start_mm, search_mm = (102.98, 0.05) if mode == "step" else (102.6, 1.0)
    path = probe_files.lay_out(tmp_path, drive=drive, start_mm=start_mm, search_mm=search_mm, block="turns = 1", **more)
    path.write_text(
        path.read_text().replace("velocity_deg_s = 180.0", FAST).replace("reach_mm = 8.0", "reach_mm = 1.5")
    )
    return path


@pytest.mark.outside
@pytest.mark.parametrize("drive", [probe_files.CANOPEN, probe_files.MODBUS], ids=["canopen", "modbus"])
def test_the_same_contacts_by_pulses_as_without_a_wire(tmp_path: Path, drive: str) -> None:
    """By latching: `test_probe_verbs`, on each wire."""
    found = []
    for face in (probe_files.VIRTUAL, drive):
        config = load_probe_machine(lay_out(tmp_path, face, "step"))
        bench = probe_bench(config, TRUTH)
        with connected_probe(config, mode="step", bench=bench) as session:
            found.append(measure_run_out(session))
        assert not any(servo.powered for servo in bench.servos.values())
    without, over = found
    assert over.feeds == without.feeds
    error_um = [1000 * (a - b) for a, b in zip((over.run_out.x_mm, over.run_out.y_mm), STYLUS.offset_mm, strict=True)]
    assert max(map(abs, error_um)) <= 1.0
    assert over.run_out.tip_radius_mm == pytest.approx(2.0, abs=1e-3)


@pytest.mark.outside
def test_three_drives_on_one_bus_share_its_link(tmp_path: Path) -> None:
    config = load_probe_machine(lay_out(tmp_path, probe_files.VIRTUAL, "latch"))
    bench = probe_bench(config, TRUTH)
    links, channel = Links(), uuid.uuid4().hex
    drives: dict[str, ServoDrive] = {}
    with ExitStack() as stack:
        for node_id, (name, axis) in enumerate(config.axes.items(), start=1):
            slave = stack.enter_context(served(bench.servos[name], bench.clock, channel=channel, node_id=node_id))
            bench.wire(name, slave.profile.probe, 1)
            on_bus = replace(axis.drive, backend="canopen", interface="virtual", channel=channel, node_id=node_id)
            patient = replace(on_bus, sdo_timeout_s=10.0, sample_timeout_s=10.0, heartbeat_s=None)
            drives[name] = hardware_drive(replace(axis, drive=patient), bench.clock, stack, links)
        bench.watch_probe()
        with probe_session(config, drives) as session:
            found = measure_run_out(session).run_out
    assert len(links.can) == 1
    assert (found.x_mm, found.y_mm) == pytest.approx(STYLUS.offset_mm, abs=1e-3)


def test_modbus_drives_of_one_line_share_it(tmp_path: Path) -> None:
    links, drives = Links(), []
    for unit in (1, 2):
        path = probe_files.lay_out(tmp_path)
        axis = path.with_name("X.toml")
        where = f'backend = "modbus"\nregister_map = "vendor_style"\nurl = "tcp://127.0.0.1:502"\nunit = {unit}'
        axis.write_text(axis.read_text().replace('backend = "bench"\nface = "virtual"', where))
        with ExitStack() as stack:
            drives.append(hardware_drive(load_drive_axis(axis), WallClock(), stack, links))
    first, second = drives
    assert isinstance(first, ModbusDrive)
    assert isinstance(second, ModbusDrive)
    assert first.link is second.link
    assert (first.unit, second.unit) == (1, 2)


def test_a_drive_that_neither_latches_nor_shows_the_signal_is_refused_before_it_moves(tmp_path: Path) -> None:
    config = load_probe_machine(lay_out(tmp_path, probe_files.VENDOR, "latch", spindle_drive=probe_files.VIRTUAL))
    bench = probe_bench(config, TRUTH)
    with pytest.raises(CapabilityError, match="drive X cannot do: touch probe; nothing was moved, expected mode step"):
        connected_probe(config, bench=bench).__enter__()
    bench = probe_bench(config, TRUTH)
    with (
        pytest.raises(CapabilityError, match="its register map has no register digital_inputs"),
        connected_probe(config, mode="step", bench=bench),
    ):
        pass
    assert bench.place("x") == pytest.approx(config.block.start_mm)
