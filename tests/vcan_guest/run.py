"""Run a command under a Linux that has SocketCAN: this host's files, another kernel (`guest_image.py`).

    python tests/vcan_guest/run.py [--out DIR] [--timeout SECONDS] -- COMMAND [ARGUMENT...]

The command sees this host's files as they are (what it writes is gone afterwards, except in the directory that HIL_OUT names
there: with --out its contents come back), the interfaces vcan0, vcan1 and lo, and HIL_VCAN=guest. It runs as root in the same
working directory. Its output is passed on as it comes. Exit status: the command's; 124 out of time; 125 no guest could be
had, with the reason on the last line of stderr.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import platform
import re
import selectors
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from guest_image import EMULATED, USER_MODE, Image, ImageError, Kind, image

QEMU = "qemu-system-x86_64"
BOOT_LIMITS_S = (120.0, 240.0, 480.0)
"""For each attempt to boot the emulated guest. It is ready after 15 s on a free host; one was seen, on a busy host, that had said
nothing after its firmware within 300 s. User-mode Linux has the first of them."""
OUT_OF_TIME, NO_GUEST = 124, 125
PASSED_ON = re.compile(r"PATH|HOME|LANG|LC_.*|TZ|VIRTUAL_ENV|PYTHON.*|HIL_.*|HYPOTHESIS_.*|OPENBLAS_.*")
BOOT_ARGUMENTS = (
    "console=ttyS0 quiet panic=-1 no_timer_check tsc=reliable random.trust_cpu=on mitigations=off 8250.nr_uarts=1"
)
PR_SET_PDEATHSIG = 1
MARK = "HIL-GUEST "


class OutOfTimeError(Exception):
    """The time limit is over."""


class NotUpError(Exception):
    """The guest did not get as far as the command."""


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="directory that gets what the command wrote to $HIL_OUT")
    parser.add_argument("--timeout", type=float, default=600.0, help="seconds for the whole of it (600)")
    parser.add_argument("command", nargs="+")
    options = parser.parse_args(arguments)
    end = time.monotonic() + options.timeout
    try:
        return run(options.command, options.out, end)
    except ImageError as error:
        print(f"vcan guest: {error}", file=sys.stderr)
        return NO_GUEST
    except OutOfTimeError as error:
        print(f"vcan guest: not done within {options.timeout:g} s: {error}", file=sys.stderr)
        return OUT_OF_TIME


def run(command: list[str], out: Path | None, end: float) -> int:
    """Boot, run, bring back; the command's exit status."""
    if platform.machine() != "x86_64":
        raise ImageError(
            f"the guest runs this host's programs and is made for x86_64 only, this is {platform.machine()}"
        )
    with tempfile.TemporaryDirectory(prefix="hil-vcan-guest-") as job_name:
        job = Path(job_name)
        (job / "out").mkdir()
        (job / "job.sh").write_text(job_script(command))
        _watch(job, end)
        if out is not None:
            shutil.copytree(job / "out", out, dirs_exist_ok=True)
        try:
            return int((job / "status").read_text())
        except (OSError, ValueError) as error:
            raise ImageError("the guest went down without an exit status; what it said stands above") from error


def cache_directory() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "hil-vcan-guest"


def job_script(command: list[str]) -> str:
    """A shell script that runs the command where and as it would run here."""
    exports = {name: value for name, value in os.environ.items() if PASSED_ON.fullmatch(name)}
    exports |= {"HIL_VCAN": "guest", "HIL_OUT": "/hil-job/out"}
    lines = [f"export {name}={shlex.quote(value)}" for name, value in exports.items()]
    return "\n".join([*lines, f"cd {shlex.quote(os.getcwd())} || exit", f"exec {shlex.join(command)}", ""])


def user_mode_command(started: Image, job: Path) -> list[str]:
    """The kernel itself, a process here. `hil_job` becomes a variable of its first process."""
    return [
        *(
            str(started.kernel),
            "mem=1536M",
            f"initrd={started.initramfs}",
            "con0=fd:0,fd:1",
            "con=null",
            "quiet",
            "panic=-1",
        ),
        f"hil_job={job}",
    ]


def emulator_command(started: Image, job: Path) -> list[str]:
    if shutil.which(QEMU) is None:
        raise ImageError(f"{QEMU} is not here; please run: apt-get install qemu-system-x86")
    return [
        *(QEMU, "-accel", "tcg,thread=multi", "-cpu", "max", "-smp", "2", "-m", "1536"),
        *("-nographic", "-no-reboot", "-nodefaults", "-serial", "stdio", "-monitor", "none", "-nic", "none"),
        *("-kernel", str(started.kernel), "-initrd", str(started.initramfs), "-append", BOOT_ARGUMENTS),
        *("-virtfs", "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"),
        # commas in a path are doubled for qemu
        *("-virtfs", f"local,path={str(job).replace(',', ',,')},mount_tag=job,security_model=none"),
    ]


def _watch(job: Path, end: float) -> None:
    """Run a guest to its end, passing on what the command prints: the quick one, or where it cannot be had or does not come up, the
    emulated one. Raises ImageError, OutOfTimeError."""
    ways: tuple[tuple[Kind, Callable[[Image, Path], list[str]], tuple[float, ...]], ...] = (
        (USER_MODE, user_mode_command, BOOT_LIMITS_S[:1]),
        (EMULATED, emulator_command, BOOT_LIMITS_S),
    )
    said = ""
    for kind, command, limits_s in ways:
        for limit_s in limits_s:
            try:
                return _watch_once(command(image(cache_directory(), kind), job), end, limit_s)
            except (NotUpError, ImageError) as error:
                said = str(error)
                print(f"vcan guest: {said}", file=sys.stderr, flush=True)
    raise ImageError(said)


def _watch_once(command: list[str], end: float, limit_s: float) -> None:
    """One attempt. Raises NotUpError where it ended before the command began, else as `_watch`."""
    before = time.monotonic()
    parent = os.getpid()
    guest = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,  # user-mode Linux is a group of processes
        preexec_fn=lambda: _die_with(parent),  # noqa: PLW1509  this script has one thread
    )
    console = Console(guest)
    try:
        _boot(console, min(end, before + limit_s))
        print(f"vcan guest: ready after {time.monotonic() - before:.1f} s", file=sys.stderr, flush=True)
        while (line := console.line(end)) is not None and not line.startswith(MARK):
            print(line, flush=True)
    finally:
        os.killpg(guest.pid, signal.SIGKILL)
        guest.wait()


def _boot(console: Console, end: float) -> None:
    """Read up to the line that says that everything is in place."""
    said: list[str] = []
    try:
        while (line := console.line(end)) is not None:
            said.append(line)
            _, mark, news = line.partition(MARK)  # the firmware's escape sequences may stand before it
            if mark and news == "READY":
                return
            if mark and news.startswith("FAILED"):
                raise ImageError(f"the guest did not come up: {news}")
    except OutOfTimeError:
        said.append("nothing more within the time it has")
    raise NotUpError(f"the guest did not come up: {' | '.join(said[-5:])}")


class Console:
    """The lines of the guest's serial console, read with a time limit."""

    def __init__(self, guest: subprocess.Popen[bytes]) -> None:
        if guest.stdout is None:
            raise ValueError("the guest was started without a pipe")
        self._pipe = guest.stdout
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._pipe, selectors.EVENT_READ)
        self._text = b""

    def line(self, end: float) -> str | None:
        """The next line; None once the guest has ended. Raises OutOfTimeError at the monotonic time `end`."""
        while b"\n" not in self._text:
            left = end - time.monotonic()
            if left <= 0:
                raise OutOfTimeError(self._text.decode(errors="replace") or "its last line was whole")
            if self._selector.select(left):
                data = os.read(self._pipe.fileno(), 65536)
                if not data:
                    return None
                self._text += data
        line, _, self._text = self._text.partition(b"\n")
        return line.decode(errors="replace").rstrip("\r")


def _die_with(parent: int) -> None:
    """In the child: be killed when whoever started us goes, however it goes."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    sys.exit(main(sys.argv[1:]))
