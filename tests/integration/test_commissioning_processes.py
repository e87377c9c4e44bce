"""A machine in one process, its commissioning in another, in real time: what is measured, and how it ends when something breaks.

The wires are a Modbus TCP port on loopback, an slcan adapter on a pty, and vcan0 where the kernel has it or the guest brings it.
"""

from __future__ import annotations

import json
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from support.bench_axis import PASSWORDS
from support.commissioning import Job, kept, look, prepare, rows_of, wait_for
from support.sim_process import SimProcess, sim

from hil.cli.main import main

WIRES = {
    "modbus tcp": ("modbus", "--tcp", "127.0.0.1:0"),
    "slcan": ("drive", "--interface", "slcan-pty"),
    "vcan": ("drive", "--channel", "vcan0", "--node", "5"),
}
SLOW = pytest.mark.slow
ON_CAN = [pytest.param("slcan", marks=SLOW), pytest.param("vcan", marks=[pytest.mark.vcan, SLOW])]
DISABLED = "switch on disabled"
INTERRUPTED = 130


@dataclass
class Shop:
    """A machine, its axis file, and whatever shows its laser."""

    machine: SimProcess
    laser: SimProcess
    axis: Path

    def look(self) -> tuple[str, float]:
        """State and position of the drive, as another master sees them."""
        found = look(self.machine.place["drive"], self.axis.with_name("scan.json"))
        return found["state"], found.get("position_counts", found.get("position_raw"))

    def stands_disabled(self) -> bool:
        first, second = self.look(), self.look()
        return first == second and first[0] == DISABLED


@contextmanager
def shop(wire: str, directory: Path, *, drive: str = "", apart: bool = False, velocity: float = 20.0) -> Iterator[Shop]:
    """A running machine. apart: the laser is a process of its own, and looks at another axis, which stands."""
    path = directory / "X.toml"
    arguments = ("--machine", "geometric", "--seed", "5")
    with sim(*WIRES[wire], "--laser", "--axis-file", str(path), *arguments) as machine:
        prepare(path, drive=drive, velocity=velocity)
        if not apart:
            yield Shop(machine, machine, path)
            return
        with sim("laser", "--still", *arguments) as laser:
            own, other = machine.place["laser"]["port"], laser.place["laser"]["port"]
            path.write_text(path.read_text(encoding="utf-8").replace(f'"{own}"', f'"{other}"'), encoding="utf-8")
            yield Shop(machine, laser, path)


@pytest.mark.parametrize("wire", ["modbus tcp", pytest.param("vcan", marks=pytest.mark.vcan)])
def test_an_axis_is_examined_over_a_real_wire(wire: str, tmp_path: Path) -> None:
    with shop(wire, tmp_path, velocity=80.0) as at:
        assert main(["doctor", str(at.axis), "--json", str(tmp_path / "doctor.json")]) == 0
        checks = json.loads((tmp_path / "doctor.json").read_text())["checks"]
        table = ["drive's table"] if wire == "modbus tcp" else []  # its register map has one
        names = ["drive", "limits", "scaling", *table, "instrument", "units"]
        assert [check["name"] for check in checks] == names
        assert at.stands_disabled()


@pytest.mark.parametrize(
    "wire",
    [pytest.param("modbus tcp", marks=SLOW), "slcan", pytest.param("vcan", marks=[pytest.mark.vcan, SLOW])],
)
def test_an_axis_is_calibrated_over_a_real_wire(wire: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in PASSWORDS.items():
        monkeypatch.setenv(name, value)
    with shop(wire, tmp_path, velocity=80.0) as at:
        assert main(["calibrate", str(at.axis), "--json", str(tmp_path / "calibrate.json")]) == 0
        result = json.loads((tmp_path / "calibrate.json").read_text())
        assert result["before"]["rms_um"] > 2.0
        assert result["rounds"][-1]["rms_um"] < 0.3
        assert (at.machine.end(), at.machine.errors) == (0, ""), at.machine.errors
        assert at.machine.left is not None
        assert (at.machine.left["powered"], at.machine.left["moving"]) == (False, False)


@pytest.mark.parametrize("wire", ["modbus tcp", *ON_CAN])
def test_ctrl_c_stops_and_disables_the_axis_and_keeps_the_rows(wire: str, tmp_path: Path) -> None:
    with shop(wire, tmp_path) as at:
        with Job("calibrate", str(at.axis)) as job:
            wait_for(lambda: rows_of(at.axis) >= 2, "two rows", unless_ended=job.process)
            seen = rows_of(at.axis)
            job.process.send_signal(signal.SIGINT)
            status, errors = job.ended()
        assert status == INTERRUPTED
        assert errors == "hil: interrupted; the axis was stopped, what was measured is kept\n"
        assert seen <= len(kept(at.axis)) < 6
        assert at.stands_disabled()


@pytest.mark.slow
def test_an_interrupted_calibration_goes_on_where_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in PASSWORDS.items():
        monkeypatch.setenv(name, value)
    with shop("modbus tcp", tmp_path, velocity=60.0) as at:
        with Job("calibrate", str(at.axis)) as job:
            wait_for(lambda: rows_of(at.axis) >= 2, "two rows", unless_ended=job.process)
            job.process.send_signal(signal.SIGTERM)
            assert job.ended()[0] == INTERRUPTED
        before = kept(at.axis)
        assert main(["calibrate", str(at.axis), "--resume", "--json", str(tmp_path / "calibrate.json")]) == 0
        whole = kept(at.axis)
        assert len(whole) == 6
        assert list(whole.measured_mm[: len(before)]) == list(before.measured_mm)
        assert json.loads((tmp_path / "calibrate.json").read_text())["rounds"][-1]["rms_um"] < 0.5


SILENT = (signal.SIGSTOP, r"instrument umd: no reading (for|in) ")
KILLED = (signal.SIGKILL, r"port /dev/pts/.* is gone")


@pytest.mark.parametrize(
    ("wire", "number", "words"),
    [
        pytest.param("modbus tcp", *SILENT, id="silent"),
        pytest.param("modbus tcp", *KILLED, id="killed"),
        pytest.param("slcan", *SILENT, id="silent-slcan", marks=SLOW),
        pytest.param("slcan", *KILLED, id="killed-slcan", marks=SLOW),
        pytest.param("vcan", *SILENT, id="silent-vcan", marks=[pytest.mark.vcan, SLOW]),
    ],
)
def test_a_laser_that_falls_silent_or_dies_stops_the_axis(
    wire: str, number: signal.Signals, words: str, tmp_path: Path
) -> None:
    with shop(wire, tmp_path, apart=True) as at:
        with Job("calibrate", str(at.axis)) as job:
            wait_for(lambda: rows_of(at.axis) >= 1, "a row", unless_ended=job.process)
            seen = rows_of(at.axis)
            at.laser.process.send_signal(number)
            status, errors = job.ended()
        at.laser.process.kill()
        assert status == 1
        assert errors.count("\n") == 1
        assert re.search(words, errors)
        assert len(kept(at.axis)) >= seen
        assert at.stands_disabled()


@pytest.mark.slow
@pytest.mark.parametrize("wire", ["modbus tcp", "slcan"])
def test_a_drive_that_dies_ends_the_job_and_keeps_the_rows(wire: str, tmp_path: Path) -> None:
    with shop(wire, tmp_path) as at, Job("calibrate", str(at.axis)) as job:
        wait_for(lambda: rows_of(at.axis) >= 1, "a row", unless_ended=job.process)
        at.machine.process.kill()
        status, errors = job.ended()
        assert status == 1
        assert errors.count("\n") == 1
        assert errors.startswith("hil: ")
        assert len(kept(at.axis)) >= 1


@pytest.mark.parametrize("wire", ON_CAN)
def test_a_guarded_drive_stops_by_itself_when_its_master_is_killed(wire: str, tmp_path: Path) -> None:
    """Nothing can be told to a drive by a process that was killed: it has to miss its master by itself."""
    with shop(wire, tmp_path, velocity=1.0) as at:
        with Job("calibrate", str(at.axis)) as job:
            wait_for(lambda: rows_of(at.axis) >= 1, "a row", unless_ended=job.process)
            job.process.kill()
        wait_for(lambda: at.look()[0] in ("quick stop active", DISABLED), "the drive's own stop")
        wait_for(lambda: at.look() == at.look(), "standstill")
        assert at.machine.end() == 0, at.machine.errors
        assert at.machine.left is not None
        assert at.machine.left["moving"] is False
        assert at.machine.left["position_mm"] < 15.0, "it was on its way there"
