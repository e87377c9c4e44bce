"""The guest's launcher against stand-ins for its kernels: it ends in time and says what is wrong, whatever the guest does."""

import importlib
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

TOOLS = Path(__file__).parents[2] / "vcan_guest"


@pytest.fixture
def guest_image(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(TOOLS))
    return importlib.import_module("guest_image")


Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run(tmp_path: Path, guest_image: Any) -> Run:
    """run(qemu, *arguments): run.py with that shell script as qemu and an image that is none. user_mode: the script that is user-mode
    Linux, one that does not come up."""
    for kind in ("linux", "uml"):
        (tmp_path / "hil-vcan-guest" / f"{kind}-0-{guest_image.recipe()}").mkdir(parents=True)
    (tmp_path / "bin").mkdir()

    def program(path: Path, text: str) -> None:
        # $job: the directory shared with the guest
        find = "*mount_tag=job*) job=${each#local,path=}; job=${job%%,*};; hil_job=*) job=${each#hil_job=};;"
        path.write_text(f"#!/bin/sh\nfor each; do case $each in {find} esac; done\n{text}\n")
        path.chmod(0o755)

    def run_it(qemu: str | None, *arguments: str, user_mode: str = "exit 1") -> subprocess.CompletedProcess[str]:
        program(tmp_path / "hil-vcan-guest" / f"uml-0-{guest_image.recipe()}" / "kernel", user_mode)
        if qemu is not None:
            program(tmp_path / "bin" / "qemu-system-x86_64", qemu)
        path = f"{tmp_path / 'bin'}:{os.environ['PATH'] if qemu is not None else ''}"
        return subprocess.run(
            [sys.executable, str(TOOLS / "run.py"), *arguments],
            env={**os.environ, "XDG_CACHE_HOME": str(tmp_path), "PATH": path},
            capture_output=True,
            text=True,
            check=False,
            timeout=30,
        )

    return run_it


@pytest.mark.parametrize("user_mode", [True, False])
def test_status_output_and_files_come_back(run: Run, tmp_path: Path, user_mode: bool) -> None:
    guest = (
        'echo noise; echo "HIL-GUEST READY"; sed "s#/hil-job#$job#" $job/job.sh >$job/moved.sh;'
        "sh $job/moved.sh; echo $? >$job/status; echo HIL-GUEST DONE; echo noise"
    )
    out = tmp_path / "out"
    result = run(
        "exit 1" if user_mode else guest,
        "--out",
        str(out),
        "--",
        "sh",
        "-c",
        'echo "$1 in $HIL_VCAN"; echo kept >$HIL_OUT/file; exit 7',
        "x",
        "a  b",
        user_mode=guest if user_mode else "exit 1",
    )
    assert (result.returncode, result.stdout) == (7, "a  b in guest\n")
    assert (out / "file").read_text() == "kept\n"


@pytest.mark.outside  # a real time-out
def test_a_guest_that_hangs_is_ended_in_time(run: Run) -> None:
    before = time.monotonic()
    result = run('echo "HIL-GUEST READY"; echo started; exec sleep 25', "--timeout", "1", "--", "true")
    assert result.returncode == 124
    assert result.stdout == "started\n"
    assert "not done within 1 s" in result.stderr
    assert time.monotonic() - before < 10


@pytest.mark.parametrize(
    ("qemu", "said"),
    [
        ('echo "HIL-GUEST FAILED: mount"; exec sleep 25', "the guest did not come up: FAILED: mount"),
        ("echo Kernel panic", "the guest did not come up: Kernel panic"),
        ('echo "HIL-GUEST READY"', "went down without an exit status"),
        (None, "apt-get install qemu-system-x86"),
    ],
    ids=["init", "kernel", "no status", "no qemu"],
)
def test_no_guest_is_no_success(run: Run, qemu: str | None, said: str) -> None:
    result = run(qemu, "--timeout", "20", "--", "true")
    assert result.returncode == 125
    assert said in result.stderr.splitlines()[-1]


def test_a_guest_that_does_not_boot_is_started_again(run: Run, tmp_path: Path) -> None:
    first = tmp_path / "first"
    result = run(
        f'[ -e {first} ] || {{ touch {first}; echo SeaBIOS; exit; }}; echo "HIL-GUEST READY"; echo 0 > $job/status',
        *("--timeout", "20", "--", "true"),
    )
    assert result.returncode == 0, result.stderr
    assert "did not come up: SeaBIOS" in result.stderr


def test_a_build_that_fails_leaves_nothing_in_the_cache(
    guest_image: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    cache = tmp_path / "cache"
    with pytest.raises(guest_image.ImageError, match="apt-get is not here"):
        guest_image.image(cache, guest_image.EMULATED)
    assert list(cache.iterdir()) == []


def test_half_a_build_and_other_recipes_are_not_taken_for_an_image(
    guest_image: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in (f"building-{guest_image.recipe()}", "uml-1-000000000000"):
        (tmp_path / name).mkdir()
    monkeypatch.setenv("PATH", "")
    with pytest.raises(guest_image.ImageError):
        guest_image.image(tmp_path, guest_image.USER_MODE)


def test_the_archive_is_read_by_another_program(guest_image: Any, tmp_path: Path) -> None:
    if shutil.which("cpio") is None:
        pytest.skip("cpio is not installed")
    entries = [("a", 0o040755, b""), ("a/b", 0o100755, b"12345"), ("TRAILER!!!", 0, b"")]
    archive = b"".join(guest_image._cpio(name, mode, data) for name, mode, data in entries)
    subprocess.run(["cpio", "-i", "--quiet"], input=archive, cwd=tmp_path, check=True, timeout=20)
    assert (tmp_path / "a" / "b").read_bytes() == b"12345"
    assert (tmp_path / "a" / "b").stat().st_mode == 0o100755
