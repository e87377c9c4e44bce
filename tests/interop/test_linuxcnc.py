"""LinuxCNC itself as the judge of its own format: it loads our COMP_FILE and adds to the joint's command what our tables say.

Runs Debian's linuxcnc-uspace without a screen: a machine of one joint with trivial kinematics, whose DISPLAY is linuxcnc_display.py.
It will not run as root, and one at a time is all a computer holds. It interpolates while the joint moves and keeps what it had in
the last cycle of the motion, a fraction of a micrometre before the end: a moderate acceleration makes that fraction small.
"""

from __future__ import annotations

import fcntl
import json
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.correction.formats import linuxcnc
from hil.correction.formats.linuxcnc import LinuxCncSettings
from hil.correction.tables import DirectionalTable, TableMode, TableSet

pytestmark = [
    pytest.mark.linuxcnc,
    pytest.mark.outside,
    pytest.mark.skipif(
        shutil.which("linuxcnc") is None or shutil.which("script") is None,
        reason="LinuxCNC is not installed (Debian: linuxcnc-uspace, bsdutils)",
    ),
]

DISPLAY = Path(__file__).with_name("linuxcnc_display.py")
ORDINARY_USER = "nobody"
TIMEOUT_S = 150
NM = 1e-3  # in µm

INI = """\
[EMC]
MACHINE = one joint
VERSION = 1.1
[DISPLAY]
DISPLAY = {folder}/display.py
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = one.var
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1
SERVO_PERIOD = 1000000
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
TOOL_TABLE = tool.tbl
[HAL]
HALFILE = one.hal
[TRAJ]
COORDINATES = X
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = 1000
[KINS]
KINEMATICS = trivkins coordinates=X
JOINTS = 1
[AXIS_X]
MIN_LIMIT = -2000
MAX_LIMIT = 2000
MAX_VELOCITY = 1000
MAX_ACCELERATION = 5000
[JOINT_0]
TYPE = LINEAR
MIN_LIMIT = -2000
MAX_LIMIT = 2000
MAX_VELOCITY = 1000
MAX_ACCELERATION = 5000
FERROR = 100
MIN_FERROR = 100
HOME = 0
HOME_OFFSET = 0
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
COMP_FILE = comp.txt
COMP_FILE_TYPE = {comp_type}
"""

HAL = """\
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
loadrt sum2
addf motion-command-handler servo-thread
addf motion-controller servo-thread
addf sum2.0 servo-thread
setp sum2.0.gain1 -1
net motor joint.0.motor-pos-cmd => joint.0.motor-pos-fb sum2.0.in0
net joint joint.0.pos-cmd => sum2.0.in1
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net change iocontrol.0.tool-change => iocontrol.0.tool-changed
"""


@contextmanager
def _alone() -> Iterator[None]:
    """LinuxCNC's shared memory is the computer's, not the process's."""
    with (Path(tempfile.gettempdir()) / f"hil-linuxcnc-{os.geteuid()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _ordinary_user(folder: Path) -> dict[str, Any]:
    """What makes a process of root an ordinary user's, who then owns the folder."""
    if os.geteuid() != 0:
        return {}
    account = pwd.getpwnam(ORDINARY_USER)
    for path in (folder, *folder.iterdir()):
        shutil.chown(path, account.pw_uid, account.pw_gid)
    return {"user": account.pw_uid, "group": account.pw_gid, "extra_groups": []}


def run_linuxcnc(comp_file: str, comp_type: int, moves_mm: list[float]) -> list[dict[str, float]]:
    """Go to the positions in turn; what LinuxCNC's joint adds at each: `position_mm` as commanded, `added_mm`."""
    with _alone(), tempfile.TemporaryDirectory(prefix="hil-linuxcnc-") as name:
        folder = Path(name)
        (folder / "one.ini").write_text(INI.format(folder=folder, comp_type=comp_type))
        (folder / "one.hal").write_text(HAL)
        (folder / "tool.tbl").write_text("")
        (folder / "comp.txt").write_text(comp_file)
        (folder / "moves.json").write_text(json.dumps(moves_mm))
        shutil.copy(DISPLAY, folder / "display.py")
        (folder / "display.py").chmod(0o755)
        how = {"cwd": folder, "env": {"HOME": name, "PATH": "/usr/bin:/bin"}, **_ordinary_user(folder)}
        with subprocess.Popen(
            ["script", "-qec", f"linuxcnc {folder}/one.ini", "/dev/null"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            **how,
        ) as process:
            try:
                said = process.communicate(timeout=TIMEOUT_S)[0].decode(errors="replace")
            except BaseException:
                os.killpg(process.pid, signal.SIGKILL)
                subprocess.run(["halrun", "-U"], timeout=60, check=False, **how)
                raise
        readings = folder / "readings.json"
        if not readings.exists():
            pytest.fail(f"LinuxCNC wrote no readings:\n{said}")
        found: list[dict[str, float]] = json.loads(readings.read_text())
    return found


def machine() -> TableSet:
    """37 uneven sections from -310 to 480 mm, tens of µm, a backlash that varies along the axis."""
    rng = np.random.default_rng(7)
    positions = np.sort(np.round(rng.uniform(-310, 480, 37), 3))
    plus = 25 * np.sin(positions / 90) + rng.normal(0, 2, 37)
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(positions, plus, plus - 8 - 3 * np.cos(positions / 60)))


@pytest.mark.parametrize("comp_type", [0, 1])
def test_linuxcnc_adds_what_our_tables_say(comp_type: int) -> None:
    tables = machine()
    text = linuxcnc.export(tables, LinuxCncSettings(comp_type)).text
    nodes = tables.pitch.position_mm
    random = np.random.default_rng(comp_type).uniform(nodes[0], nodes[-1], 38)
    upwards = np.round(np.sort(np.concatenate([random, nodes[::3], [nodes[0] - 40, nodes[-1] + 40]])), 6)
    moves = [float(upwards[0]) - 5, *upwards.tolist(), float(upwards[-1]) + 5, *upwards[::-1].tolist()]
    readings = run_linuxcnc(text, comp_type, moves)
    assert len(upwards) >= 50
    assert len(readings) == len(moves)
    count = len(upwards)
    for direction, target, taken in ((1, upwards, readings[1 : count + 1]), (-1, upwards[::-1], readings[count + 2 :])):
        commanded = np.array([reading["position_mm"] for reading in taken])
        added_um = 1000 * np.array([reading["added_mm"] for reading in taken])
        assert np.max(np.abs(commanded - target)) < 1e-6
        difference_um = added_um - tables.correction_um(target, direction)
        worst_nm = float(np.max(np.abs(difference_um))) / NM
        print(f"type {comp_type}, direction {direction:+d}: {len(target)} positions, at most {worst_nm:.4f} nm apart")
        assert np.max(np.abs(difference_um)) <= 1 * NM
        assert np.max(np.abs(added_um - tables.correction_um(target, -direction))) > 5  # the directions are told apart


def test_linuxcnc_stops_reading_at_a_header() -> None:
    """Why our file has none, and why `load` refuses one: the control says nothing and corrects nothing."""
    text = "# nominal forward reverse\n" + linuxcnc.export(machine()).text
    readings = run_linuxcnc(text, 1, [10.0, 100.0])
    assert [reading["added_mm"] for reading in readings] == [0.0, 0.0]
