"""What `hil panel` refuses before it listens anywhere."""

import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, cast

import pytest
import uvicorn
from support.bench_axis import lay_out

from hil.app.main import main
from hil.app.panel.server import Server, ServerAccess


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--bind", "0.0.0.0"), "--bind 0.0.0.0 is not loopback, expected --cert and --key"),
        (("--bind", "192.0.2.1", "--cert", "x.crt"), "--cert and --key go together"),
        (("--bind", "192.0.2.1", "--cert", "x.crt", "--key", "x.key"), "x.crt: is not there"),
        (("--port", "65536"), "expected a port, 0 to 65535"),
        (("--pace", "-1"), "expected a number >= 0"),
        (("--probe", "mill.toml"), "mill.toml: cannot be read"),
    ],
)
def test_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], said: str
) -> None:
    try:
        status = main(["panel", str(lay_out(tmp_path)), *arguments])
    except SystemExit as ended:  # argparse's own
        status = int(ended.code or 0)
    assert status == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("token", "mode", "said"),
    [
        ("x" * 40 + "\n", 0o600, "holds a token of 0 bits at most, expected 128"),
        ("0123456789abcdef\n", 0o600, "holds a token of 64 bits at most"),
        ("kqZx3-tT0gJm4RbU_vyS9w\n", 0o644, "has the mode 644, expected 600"),
    ],
)
def test_a_token_that_others_can_read_or_guess_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], token: str, mode: int, said: str
) -> None:
    path = tmp_path / "token"
    path.write_text(token)
    path.chmod(mode)
    assert main(["panel", str(lay_out(tmp_path)), "--name", "mill.example", "--token-file", str(path)]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("names", [[], ["mill.example"]])
def test_another_name_of_loopback_asks_for_the_token(
    names: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served: list[ServerAccess] = []
    monkeypatch.setattr("hil.app.panel.server.serve", lambda _desks, access, *_: served.append(access))
    path = tmp_path / "token"
    named = [word for name in names for word in ("--name", name)]
    assert main(["panel", str(lay_out(tmp_path)), *named, "--token-file", str(path)]) == 0
    (access,) = served
    assert access.tls is None
    assert (access.token is not None) == bool(names)
    if names:
        assert access.token == path.read_text().strip()
        assert len(access.token) >= 22
        assert path.stat().st_mode & 0o777 == 0o600


@pytest.mark.outside
def test_files_are_their_owners_alone_by_default(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that the program writes as a process of its own."""
    records = tmp_path / "records.csv"
    records.write_text(
        "run,direction,target_mm,measured_mm\n1,1,0.0,0.0\n1,1,10.0,10.001\n1,-1,10.0,10.002\n1,-1,0,0.001\n"
    )
    for umask, mode in (("", 0o600), ("022", 0o644)):
        out = tmp_path / f"out{umask}.json"
        monkeypatch.setenv("HIL_UMASK", umask)
        subprocess.run([sys.executable, "-m", "hil.app", "iso230", str(records), "--json", str(out)], check=False)
        assert out.stat().st_mode & 0o777 == mode


def test_two_axes_of_one_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(lay_out(tmp_path))
    assert main(["panel", path, path]) == 2
    assert "expected a name for each" in capsys.readouterr().err


# -- a signal ------------------------------------------------------------------------------------------------------
class Axis:
    """A desk whose stop needs a lock."""

    def __init__(self) -> None:
        self.lock, self.stopped = threading.Lock(), threading.Event()

    def stop(self) -> None:
        with self.lock:
            self.stopped.set()


@pytest.mark.parametrize("sig", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_stops_every_axis_whatever_it_interrupts(sig: signal.Signals) -> None:
    """It comes in the main thread, which may hold the lock just then."""
    axes = [Axis(), Axis()]
    server = Server(uvicorn.Config(cast(Any, None)), cast(Any, axes))
    with axes[0].lock:
        server.handle_exit(sig, None)
        server.handle_exit(sig, None)
    assert all(axis.stopped.wait(20.0) for axis in axes)
    assert server.should_exit
