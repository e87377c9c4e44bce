"""The fixtures of the pytest plugin, as a user's tests have them."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import pytest

import hil
from hil.testing.drive import SimulatedDrive

ROOT = Path(__file__).parents[4]
Fault = Callable[[str], None]


def test_the_simulated_axis_is_open_with_an_instrument_and_its_time_is_simulated(simulated_axis: hil.Axis) -> None:
    simulated_axis.home()
    simulated_axis.move_to(40.0)
    seen = simulated_axis.read()
    assert seen.motor_mm == pytest.approx(40.0, abs=1e-3)
    assert seen.instrument_mm == pytest.approx(40.0, abs=0.05)
    assert len(list(simulated_axis.watch(60.0, every_s=6.0))) == 10, "a minute passes in moments"


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("beam-lost@0.1+0.2", hil.MeasurementLostError),
        ("drive-fault=0x7300", hil.DriveFaultError),
        ("jam@0.2+9", hil.DriveFaultError),
    ],
)
def test_a_fault_stops_the_simulated_axis(
    simulated_axis: hil.Axis, fault: Fault, text: str, error: type[hil.BridgeError]
) -> None:
    simulated_axis.home()
    with pytest.raises(hil.InputError, match="unknown kind tpdo-lost"):
        fault("tpdo-lost")
    fault(text)
    with pytest.raises(error):
        simulated_axis.move_to(300.0)
    assert simulated_axis.bench.plant.position_mm < 299.0
    with pytest.raises(hil.StateError, match="expected home"):
        simulated_axis.move_to(60.0)


def test_the_plugin_is_declared_under_the_name_by_which_it_is_loaded_once() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for name, module in project["entry-points"]["pytest11"].items():
        assert name == module == import_module(module).__name__


@pytest.mark.outside
@pytest.mark.parametrize("text", ["drive-fault=0x7300", "jam+2", "tpdo-lost", "beam-lost+1"])
def test_a_drive_on_the_wire_stops_and_is_left_without_power(
    simulated_drive: SimulatedDrive, fault: Fault, text: str
) -> None:
    def goes_wrong() -> None:
        with hil.open(simulated_drive.axis_file) as axis:
            axis.home()
            assert simulated_drive.powered
            axis.move_to(20.0)
            assert simulated_drive.position_mm == pytest.approx(20.0, abs=0.05)
            fault(text)
            axis.move_to(200.0)

    with pytest.raises(hil.BridgeError):
        goes_wrong()
    assert not simulated_drive.powered
    assert not simulated_drive.moving
    assert simulated_drive.position_mm < 199.0
