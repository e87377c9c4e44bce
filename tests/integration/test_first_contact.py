"""First contact with a drive that nobody described, as a user makes it: scan, new, doctor, each a process, nothing read in the code.

The drive is a process too: a strict slave made from a maker's file on an slcan adapter, or a maker's Modbus drive behind pyModbusTCP.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from support.commissioning import PATIENT
from support.places import SHARED_DATA
from support.sim_process import sim

pytestmark = pytest.mark.outside
EDS = SHARED_DATA / "eds"
needs_eds = pytest.mark.skipif(not EDS.is_dir(), reason=f"{EDS} is not there")

TESTS = Path(__file__).parents[1]
KNOWN = ("--travel=-10,300", "--max-velocity", "100", "--max-acceleration", "500", "--feed", "10")
"""What only the user knows of this machine."""


def hil(*words: str, status: int = 0) -> str:
    """What a verb says on both outputs; its exit status is as expected."""
    done = subprocess.run(
        [sys.executable, "-m", "hil.app.main", *words],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, "COLUMNS": "240"},  # no table's cell is broken
    )
    said = done.stdout + done.stderr
    assert done.returncode == status, said
    assert "Traceback" not in said
    return said


def next_command(said: str, path: Path) -> list[str]:
    """The command that a scan offers, with our file's name."""
    match = re.search(r"^next: hil (drives new X\.toml .*), then hil doctor X\.toml$", said, re.MULTILINE)
    assert match is not None, said
    return [str(path) if word == "X.toml" else word for word in shlex.split(match[1])]


def made(*command: str) -> str:
    """`hil drives new`; its file gets the waits that a busy computer needs, where two processes and a laser share it."""
    said = hil(*command)
    path = Path(command[2])
    text = path.read_text(encoding="utf-8")
    if 'backend = "canopen"' in text:
        text = text.replace("[drive]\n", f"[drive]\n{PATIENT['canopen']}\n")
    path.write_text(text.replace("[instrument]\n", "[instrument]\nstale_after_s = 3.0\n"), encoding="utf-8")
    return said


def verdicts(path: Path, *more: str, status: int = 0) -> dict[str, tuple[bool, str]]:
    out = path.with_suffix(".json")
    hil("doctor", str(path), *more, "--json", str(out), status=status)
    return {check["name"]: (check["good"], check["detail"]) for check in json.loads(out.read_text())["checks"]}


# -- CANopen -----------------------------------------------------------------------------------------------------------
@contextmanager
def drive_of(file: str) -> Iterator[tuple[list[str], str]]:
    """A strict slave of a maker's file as node 5, at rest 0 mm; what scan needs, and the laser's port."""
    eds = str(EDS / file)
    with sim(
        "drive", "--interface", "slcan-pty", "--laser", "--machine", "geometric", "--eds", eds, "--node", "5"
    ) as process:
        place = process.place
        yield ["--interface", "slcan", "--channel", place["drive"]["channel"]], place["laser"]["port"]
        process.end()
        assert process.left is not None
        assert not process.left["powered"]


@needs_eds
@pytest.mark.parametrize(
    ("file", "more", "said"),
    [
        (
            "AMflux-ETH-Zurich__AMflux__Epos4_70_15.eds",
            ("--counts-per-rev", "4096"),
            ("velocities in rev/min (60A9h)", "homing method 7, which seeks an edge of the home switch"),
        ),
        (
            "heig-vd-iai__canopen-stack__1_example.eds",
            (),  # its positions are tenths of a degree, which it says itself
            ("homing method 35, which moves nothing", "RISK of homing: takes the place where the axis stands"),
        ),
    ],
)
def test_from_a_scan_to_a_proven_axis_without_reading_anything(
    file: str, more: Sequence[str], said: Sequence[str], tmp_path: Path
) -> None:
    path = tmp_path / "X.toml"
    with drive_of(file) as (where, laser):
        command = next_command(hil("scan", *where, "--nodes", "1-16"), path)
        found = made(*command, *KNOWN, "--instrument-port", laser, *more)
        assert all(each in found for each in said), found
        checks = verdicts(path)
        assert all(good for good, _ in checks.values()), checks
        assert "speed" in checks
        text = path.read_text()
        path.write_text(text.replace("node_id = 5", "node_id = 9"))
        assert f"looked for node 9 on {where[3]}; a scan found 5" in hil("doctor", str(path), status=1)


@needs_eds
def test_a_drive_that_does_not_state_its_units_asks_for_them_and_a_wrong_answer_is_caught(tmp_path: Path) -> None:
    path = tmp_path / "X.toml"
    with drive_of("analogdevicesinc__PyTrinamic__TMCM_1270.eds") as (where, laser):
        scanned = hil("scan", *where, "--nodes", "1-16")
        assert "hil drives show trinamic_tmcm" in scanned
        command = [*next_command(scanned, path), *KNOWN, "--instrument-port", laser, "--counts-per-rev", "4096"]
        refused = hil(*command, status=1)
        assert "its unit of velocity is not known" in refused
        assert "give it by --velocity-unit" in refused
        command[command.index("canopen")] = "trinamic_tmcm"
        assert "--velocity-unit is missing, expected rpm or counts/s" in hil(*command, status=2)
        assert "you choose: rpm or counts/s" in hil("drives", "show", "trinamic_tmcm")
        assert not path.exists()
        made(*command, "--velocity-unit", "counts/s")
        wrong = verdicts(path, status=1)
        assert [name for name, (good, _) in wrong.items() if not good] == ["speed"], wrong
        path.unlink()
        made(*command, "--velocity-unit", "rpm")
        assert all(good for good, _ in verdicts(path).values())


@needs_eds
def test_notes_of_another_maker_are_refused_with_the_right_ones(tmp_path: Path) -> None:
    path = tmp_path / "X.toml"
    with drive_of("AMflux-ETH-Zurich__AMflux__Epos4_70_15.eds") as (where, laser):
        command = ["drives", "new", str(path), "--drive", "faulhaber_mc", *where, *KNOWN, "--instrument-port", laser]
        said = hil(*command, "--node", "5", status=1)
        assert "Faulhaber is vendor 147h, node 5 is of FBh: this is no faulhaber_mc" in said
        assert "use --drive maxon_epos4 or canopen" in said
        assert not path.exists()
        assert f"node 9 does not answer on {where[3]}; a scan found 5" in hil(*command, "--node", "9", status=1)


# -- Modbus ------------------------------------------------------------------------------------------------------------
@contextmanager
def maker(name: str) -> Iterator[tuple[dict[str, Any], list[dict[str, Any]]]]:
    """A family's drive as a process; how it was left is added to the list at its end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "support.maker_process", name], stdout=subprocess.PIPE, text=True, cwd=TESTS
    )
    left: list[dict[str, Any]] = []
    assert process.stdout is not None
    try:
        yield json.loads(process.stdout.readline()), left
        process.terminate()
        left.append(json.loads(process.stdout.readline()))
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


@pytest.mark.parametrize("name", ["lichuan_a6", "aasd_15a", "leadshine_el7"])
def test_from_a_scan_of_modbus_units_to_a_homed_axis(name: str, tmp_path: Path) -> None:
    path = tmp_path / "X.toml"
    with maker(name) as (place, left):
        command = next_command(hil("scan", "--tcp", place["tcp"], "--units", "1", "--map", name), path)
        counts = ["--counts-per-rev", "10000"] if name == "aasd_15a" else []
        user = [*KNOWN, *counts, "--instrument-port", place["laser"], "--timeout", "5"]
        wrong = hil(*command, *user, "--known", f"position={place['start_counts'] + 5000}", status=1)
        assert "position does not read" in wrong
        assert not path.exists()
        found = made(*command, *user, "--known", f"position={place['start_counts']}")
        assert "as the drive file says" in found
        assert "hil doctor proves them before the axis is used" in found
        checks = verdicts(path)
        assert all(good for good, _ in checks.values()), checks
        if name != "leadshine_el7":  # of its homing nothing is assumed
            assert "hil doctor AXIS.toml --home" in checks["homing"][1]
        homed = verdicts(path, "--home")
        assert homed["homing"][1].startswith("homed, and stands at"), homed
    assert left[0]["changed"] == []
    assert not left[0]["powered"]
