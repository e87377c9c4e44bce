"""A machine in one process, its commissioning in another, in real time: what is measured, and how it ends when something breaks.

The wires are a Modbus TCP port on loopback, an slcan adapter on a pty, and vcan0 where the kernel has it or the guest brings it.
"""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from support.commissioning import PATIENT, Job, kept, look, prepare, rows_of, wait_for
from support.sim_process import SimProcess, sim

import hil
from hil.app.main import main
from hil.machine.interrupts import ENDED, INTERRUPTED, STOP_WITHIN_S

pytestmark = pytest.mark.outside

WIRES = {
    "modbus tcp": ("modbus", "--tcp", "127.0.0.1:0"),
    "slcan": ("drive", "--interface", "slcan-pty"),
    "vcan": ("drive", "--channel", "vcan0", "--node", "5"),
}
ON_CAN = ["slcan", pytest.param("vcan", marks=pytest.mark.vcan)]
DISABLED = "switch on disabled"


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
def shop(
    wire: str,
    directory: Path,
    *,
    drive: str = "",
    apart: bool = False,
    velocity: float = 20.0,
    homing: tuple[str, ...] = (),
    faults: Sequence[str] = (),
) -> Iterator[Shop]:
    """A running machine. apart: the laser is a process of its own, and looks at another axis, which stands; the axis file lets it.

    homing: its option.
    """
    path = directory / "X.toml"
    arguments = ("--machine", "geometric", "--seed", "5")
    more = [*homing, *(word for fault in faults for word in ("--fault", fault))]
    with sim(*WIRES[wire], "--laser", "--axis-file", str(path), *arguments, *more) as machine:
        prepare(path, drive=drive, velocity=velocity)
        if not apart:
            yield Shop(machine, machine, path)
            return
        with sim("laser", "--still", *arguments) as laser:
            own, other = machine.place["laser"]["port"], laser.place["laser"]["port"]
            text = path.read_text(encoding="utf-8").replace(f'"{own}"', f'"{other}"')
            text = text.replace("[instrument]\n", "[instrument]\ninstrument_agrees_within_um = 1e9\n")
            path.write_text(text, encoding="utf-8")
            yield Shop(machine, laser, path)


@pytest.mark.parametrize("wire", ["modbus tcp", pytest.param("vcan", marks=pytest.mark.vcan)])
def test_a_script_moves_and_reads_an_axis_over_a_real_wire(wire: str, tmp_path: Path) -> None:
    with shop(wire, tmp_path, velocity=80.0) as at:
        with hil.open(at.axis) as axis:
            axis.home()
            readings = []
            for target_mm in (20.0, 5.0):
                axis.move_to(target_mm)
                readings.append(axis.read())
            rows = hil.Rows.of([*readings, *axis.watch(1.0)])
        assert at.stands_disabled()
    assert list(rows["direction"][:2]) == [1.0, -1.0]
    assert list(rows["motor_mm"][:2]) == pytest.approx([20.0, 5.0], abs=0.001)
    assert max(abs(rows["measured_mm"] - rows["motor_mm"])) < 0.05
    assert len(rows) > 2


@pytest.mark.usefixtures("passwords")
@pytest.mark.parametrize("wire", ["modbus tcp", *ON_CAN])
def test_an_axis_is_calibrated_over_a_real_wire(wire: str, tmp_path: Path) -> None:
    with shop(wire, tmp_path, velocity=80.0) as at:
        assert main(["calibrate", str(at.axis), "--json", str(tmp_path / "calibrate.json")]) == 0
        result = json.loads((tmp_path / "calibrate.json").read_text())
        assert result["before"]["rms_um"] > 2.0
        assert result["rounds"][-1]["rms_um"] < 0.3
        assert (at.machine.end(), at.machine.errors) == (0, ""), at.machine.errors
        assert at.machine.left is not None
        assert (at.machine.left["powered"], at.machine.left["moving"]) == (False, False)


@contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """Processes that compute without a pause."""
    running = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
        assert [each.poll() for each in running] == [None] * count
    finally:
        for each in running:
            each.kill()
            each.wait()


@pytest.mark.usefixtures("passwords")
def test_an_axis_is_calibrated_on_a_busy_computer(tmp_path: Path) -> None:
    """With the default time-outs, while four other processes compute: an answer that comes late is asked for again. Not in the
    guest: how late its emulated processors answer depends on the host, which then decides whether those time-outs are enough."""
    with shop("slcan", tmp_path, velocity=80.0) as at, busy_processes(4):
        text = at.axis.read_text(encoding="utf-8")
        assert PATIENT["canopen"] in text
        at.axis.write_text(text.replace(PATIENT["canopen"], ""), encoding="utf-8")
        assert main(["calibrate", str(at.axis), "--json", str(tmp_path / "calibrate.json")]) == 0
        result = json.loads((tmp_path / "calibrate.json").read_text())
        assert result["rounds"][-1]["rms_um"] < 0.3
        assert at.stands_disabled()


@pytest.mark.parametrize("wire", ["modbus tcp", "slcan"])
def test_ctrl_c_stops_and_disables_the_axis_and_keeps_the_rows(wire: str, tmp_path: Path) -> None:
    with shop(wire, tmp_path) as at:
        with Job("calibrate", str(at.axis)) as job:
            wait_for(lambda: rows_of(at.axis) >= 2, "two rows", unless_ended=job.process)
            seen = rows_of(at.axis)
            job.process.send_signal(signal.SIGINT)
            status, errors = job.ended()
        assert status == INTERRUPTED
        assert errors.splitlines() == [
            "hil: interrupted; the axis was stopped, what was measured is kept",
            f"hil: go on with: hil calibrate {at.axis} --resume",
        ]
        assert seen - 1 <= len(kept(at.axis)) < 6  # the last one seen may not have been confirmed when the signal came
        assert at.stands_disabled()


SILENT = (signal.SIGSTOP, r"instrument umd: no reading (for|in) ")
KILLED = (signal.SIGKILL, r"port /dev/pts/.* is gone")


@pytest.mark.parametrize(
    ("wire", "number", "words"),
    [
        pytest.param("modbus tcp", *SILENT, id="silent"),
        pytest.param("modbus tcp", *KILLED, id="killed"),
        pytest.param("slcan", *SILENT, id="silent-slcan"),
        pytest.param("slcan", *KILLED, id="killed-slcan"),
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
        said, how = errors.splitlines()
        assert re.search(words, said)
        assert how == f"hil: go on with: hil calibrate {at.axis} --resume"
        assert len(kept(at.axis)) >= seen
        assert at.stands_disabled()


@pytest.mark.parametrize("wire", ["modbus tcp", "slcan"])
def test_a_drive_that_dies_ends_the_job_and_keeps_the_rows(wire: str, tmp_path: Path) -> None:
    with shop(wire, tmp_path) as at, Job("calibrate", str(at.axis)) as job:
        wait_for(lambda: rows_of(at.axis) >= 1, "a row", unless_ended=job.process)
        at.machine.process.kill()
        status, errors = job.ended()
        assert status == 1
        said, how = errors.splitlines()
        assert said.startswith("hil: ")
        assert how == f"hil: go on with: hil calibrate {at.axis} --resume"
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


@pytest.mark.usefixtures("passwords")
@pytest.mark.parametrize(("homing", "resumes"), [((), True), (("--homing", "37"), False)], ids=["switch", "37"])
def test_resume_in_another_process_stays_in_the_zero(
    homing: tuple[str, ...],
    resumes: bool,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With 37 the axis would call the place where the interruption left it zero."""
    with shop("modbus tcp", tmp_path, velocity=60.0, homing=homing) as at:
        with Job("calibrate", str(at.axis)) as job:
            wait_for(lambda: rows_of(at.axis) >= 2, "two rows", unless_ended=job.process)
            job.process.send_signal(signal.SIGINT)
            assert job.ended()[0] == INTERRUPTED
        before = kept(at.axis)
        _, was_at = at.look()
        capsys.readouterr()
        status = main(["calibrate", str(at.axis), "--resume"])
        if resumes:
            assert status == 0
            whole = kept(at.axis)
            assert len(whole) == 6
            assert list(whole.measured_mm[: len(before)]) == list(before.measured_mm)
            errors = kept(at.axis, "round-1").error_um
            assert abs(errors).max() < 1.0
            return
        assert status == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert "homing method 37 depends on where the axis stands" in line
        assert at.look() == (DISABLED, was_at)


MOVES_BY_SCRIPT = """
import os, sys
from hil.axis.axis_file import load_drive_axis
from hil.machine.interrupts import ending_by_signals
from hil.machine.supervisor import Supervisor
from hil.machine.watched_axis import WatchedAxis
from hil.machine.wiring import connected_drive

with ending_by_signals(), connected_drive(load_drive_axis(sys.argv[1])) as drive:
    with Supervisor([WatchedAxis(drive)]) as axis:
        axis.get_ready(home=False)
        axis.move(200.0, 2.0, started=lambda: os.write(1, b"moving\\n"))
"""
SDO_DIES_S = 25.0
"""After the start of the machine: by then the script is moving it, also on a busy host."""


def test_ctrl_c_twice_ends_a_job_whose_drive_hangs_with_the_axis_stopped(tmp_path: Path) -> None:
    """From some moment on no SDO is answered, and each answer may take 5 s: longer than anybody waits for the way out."""
    with shop("slcan", tmp_path, faults=[f"sdo-lost@{SDO_DIES_S:g}"]) as at:
        began_s = time.monotonic()
        script = [sys.executable, "-c", MOVES_BY_SCRIPT, str(at.axis)]
        with subprocess.Popen(script, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as job:
            assert job.stdout is not None
            assert job.stdout.readline() == b"moving\n", job.communicate()
            wait_for(lambda: time.monotonic() - began_s > SDO_DIES_S + 1.0, "SDO is dead")
            job.send_signal(signal.SIGINT)
            time.sleep(0.5)  # signals of one moment are one
            job.send_signal(signal.SIGINT)
            asked_s = time.monotonic()
            _, errors = job.communicate(timeout=30.0)
            took_s = time.monotonic() - asked_s
        assert at.machine.end() == 0, at.machine.errors
        assert (job.returncode, errors) == (INTERRUPTED, ENDED)
        assert took_s < STOP_WITHIN_S + 1.0
        assert at.machine.left is not None
        assert at.machine.left["moving"] is False, "told to stop, although no SDO is answered"
