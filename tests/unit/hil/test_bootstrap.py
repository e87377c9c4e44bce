"""The bootstrap script's promises, with a stand-in for Python: what is installed when, and what an interruption leaves."""

import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

pytestmark = pytest.mark.outside

SCRIPT = Path(__file__).parents[3] / "hil" / "bootstrap.sh"

# notes its calls; `-m venv DIR` puts itself and a command `hil` there; `-m pip` does as the environment says
STAND_IN = """#!/bin/sh
case "$1 $2" in
    "-m venv")
        echo "venv" >>"$LOG"
        mkdir -p "$3/bin"
        cp "$0" "$3/bin/python"
        printf '#!/bin/sh\\nprintf "<%%s>" "$@"' >"$3/bin/hil"
        cp "$3/bin/hil" "$3/bin/ruff"
        chmod +x "$3/bin/hil" "$3/bin/ruff" ;;
    "-m pip")
        for last; do :; done
        echo "pip $last" >>"$LOG"
        if [ -n "$PIP_HANGS" ]; then : >"$PIP_HANGS"; while :; do sleep 0.05; done; fi
        exit "${PIP_STATUS:-0}" ;;
    "--version ") echo "Python 3.11.99" ;;
esac
"""


class Clone:
    """A clone with nothing in it but the script and a pyproject.toml, in a directory whose name holds a space."""

    def __init__(self, root: Path) -> None:
        self.root = root / "a clone"
        self.log = root / "log"
        self.bin = root / "bin"
        (self.root / "hil").mkdir(parents=True)
        self.bin.mkdir()
        shutil.copy(SCRIPT, self.root / "hil")
        self.pyproject = self.root / "pyproject.toml"
        self.pyproject.write_text("# one\n")
        python = self.bin / "python3"
        python.write_text(STAND_IN)
        python.chmod(0o755)

    def environment(self, **extra: str) -> Mapping[str, str]:
        return {"PATH": f"{self.bin}:{os.environ['PATH']}", "LOG": str(self.log), "HIL_NO_APT": "1", **extra}

    def run(self, *command: str, **extra: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["sh", str(self.root / "hil" / "bootstrap.sh"), *command],
            env=self.environment(**extra),
            capture_output=True,
            text=True,
            timeout=20,
            check=False,
        )

    def calls(self) -> list[str]:
        """What the stand-in was asked since the last time."""
        calls = self.log.read_text().splitlines() if self.log.exists() else []
        self.log.unlink(missing_ok=True)
        return calls


@pytest.fixture
def clone(tmp_path: Path) -> Clone:
    return Clone(tmp_path)


def test_it_installs_once_and_passes_the_arguments_on_as_they_are(clone: Clone) -> None:
    first = clone.run("hil", "demo", "two words", "")
    assert (first.returncode, first.stdout) == (0, "<demo><two words><>")
    assert clone.calls() == ["venv", "pip ."]

    second = clone.run("hil", "demo")
    assert (second.returncode, second.stdout, second.stderr) == (0, "<demo>", "")
    assert clone.calls() == []


def test_the_tools_bring_the_test_extra_which_serves_hil_as_well(clone: Clone) -> None:
    clone.run("hil")
    clone.calls()
    clone.run("ruff")
    assert clone.calls() == ["pip .[test]"]
    clone.run("hil")
    clone.run("ruff")
    assert clone.calls() == []


def test_a_changed_pyproject_is_installed_into_the_same_venv(clone: Clone) -> None:
    clone.run("hil")
    clone.calls()
    clone.pyproject.write_text("# two\n")
    clone.run("hil")
    assert clone.calls() == ["pip ."]


def test_a_moved_clone_gets_a_new_venv(clone: Clone) -> None:
    clone.run("hil")
    clone.calls()
    clone.root = clone.root.rename(clone.root.with_name("moved"))
    clone.run("hil")
    assert clone.calls() == ["venv", "pip ."]


def test_a_venv_made_by_hand_is_kept(clone: Clone) -> None:
    subprocess.run(
        [clone.bin / "python3", "-m", "venv", clone.root / ".venv"], env=clone.environment(), check=True, timeout=20
    )
    clone.calls()
    clone.run("hil")
    assert clone.calls() == ["pip ."]


@pytest.mark.parametrize("installed_before", [False, True])
def test_an_interrupted_installation_is_never_taken_for_a_whole_one(
    clone: Clone, installed_before: bool, until: Callable[[Callable[[], bool], str], None]
) -> None:
    if installed_before:
        clone.run("hil")
        clone.pyproject.write_text("# two\n")
    hanging = clone.root / "pip-hangs"
    process = subprocess.Popen(
        ["sh", str(clone.root / "hil" / "bootstrap.sh"), "hil"],
        env=clone.environment(PIP_HANGS=str(hanging)),
        start_new_session=True,
        stderr=subprocess.DEVNULL,
    )
    with process:
        until(hanging.exists, "pip has been started")
        os.killpg(process.pid, signal.SIGINT)  # what Ctrl-C does
        assert process.wait(20) != 0
    clone.calls()

    assert clone.run("hil").returncode == 0
    assert clone.calls() == ["venv", "pip ."]


def test_a_failed_installation_says_so_and_is_tried_again(clone: Clone) -> None:
    failed = clone.run("hil", PIP_STATUS="1")
    assert failed.returncode == 2
    assert "pip could not install the project" in failed.stderr
    clone.calls()
    assert clone.run("hil").returncode == 0
    assert clone.calls() == ["pip ."]


def test_missing_system_packages_are_named_and_the_tests_run_without(clone: Clone) -> None:
    pytest_command = clone.bin / "pytest"
    pytest_command.write_text("#!/bin/sh\necho ran")
    pytest_command.chmod(0o755)
    tools = ["sh", "cat", "cksum", "dirname", "mkdir", "rm", "cp", "chmod", "env", "id", "flock"]
    for tool in tools:  # a system that has these and nothing else
        found = shutil.which(tool)
        if found:
            (clone.bin / tool).symlink_to(found)
    result = clone.run("pytest", PATH=str(clone.bin))
    assert (result.returncode, result.stdout) == (0, "ran\n")
    assert "HIL_NO_APT is set: qemu-system-x86 zstd can-utils mbpoll gcc" in result.stderr


def test_without_a_command_it_explains_itself(clone: Clone) -> None:
    result = clone.run()
    assert result.returncode == 2
    assert result.stderr.startswith("usage: ")
