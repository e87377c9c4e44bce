"""A drive that holds a table in one process, `hil params table` in others, over an adapter on a pty, in real time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.commissioning import prepare, wait_for
from support.sim_process import sim
from support.table_axis import store

from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.correction.tables import DirectionalTable, TableMode, TableSet

pytestmark = pytest.mark.outside

POINTS = 400


def shown(axis: Path) -> tuple[bool, int]:
    """Whether the drive corrects by its table, and how many points it holds, as another process sees it."""
    out = axis.with_name("shown.json")
    assert main(["params", "table", "show", str(axis), "--json", str(out)]) == 0
    found = json.loads(out.read_text())
    return found["enabled"], found["points"]


@pytest.mark.usefixtures("passwords")
def test_one_process_writes_and_is_killed_and_others_find_what_was_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "X.toml"
    wire = ("drive", "--interface", "slcan-pty", "--table", "simulated_domain", "--machine", "ideal")
    with sim(*wire, "--laser", "--axis-file", str(path)):
        prepare(path)
        axis = load_axis(path)
        places = np.linspace(2.0, 32.0, POINTS)
        for seed in (1, 2):
            plus = 1.0 * np.random.default_rng(seed).uniform(-1.0, 1.0, POINTS)  # within the bound of 10 µm in any mm
            store(axis, TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(places, plus, plus - 5.0)))
            if seed == 1:
                unproven = ["--prove-by", "nothing"]
                assert main(["params", "table", "download", str(path), *unproven]) == 0
                assert shown(path) == (True, POINTS)
                assert main(["verify", str(path)]) == 2
                assert "would be corrected twice" in capsys.readouterr().err

        note = axis.store.directory / "drive-table-before.json"
        command = [
            sys.executable,
            "-m",
            "hil.app",
            "params",
            "table",
            "download",
            str(path),
            "--prove-by",
            "drive",
        ]
        for number, status in ((signal.SIGKILL, -signal.SIGKILL), (signal.SIGINT, 130)):
            process = subprocess.Popen(
                command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=os.environ
            )
            wait_for(note.exists, "a change under way", unless_ended=process)
            process.send_signal(number)
            process.communicate(timeout=60)
            assert process.returncode == status
            if number == signal.SIGKILL:
                assert note.exists()
                assert main(["params", "table", "remove", str(path), "--keep-contents"]) == 0
                assert "has been put back" in capsys.readouterr().err
                assert shown(path) == (False, POINTS)
        assert not note.exists()
        assert shown(path) == (False, POINTS)
        assert main(["params", "table", "remove", str(path)]) == 0
        assert shown(path) == (False, 0)
