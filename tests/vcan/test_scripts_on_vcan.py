"""The tests of the page on scripts, run as they stand there over SocketCAN."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.docs import lay_files

pytestmark = pytest.mark.vcan


def test_the_tests_of_the_page_on_scripts_pass_on_vcan0(tmp_path: Path) -> None:
    lay_files("scripts", tmp_path)
    words = [sys.executable, "-m", "pytest", "-q", "--hil-wire=vcan0", "test_positions.py"]
    environment = os.environ | {"PYTEST_PLUGINS": "hil.testing.plugin"}
    run = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=300)
    assert run.returncode == 0, run.stdout + run.stderr
    assert "2 passed" in run.stdout
