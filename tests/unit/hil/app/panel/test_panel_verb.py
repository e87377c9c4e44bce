"""What `hil panel` refuses before it listens anywhere."""

from pathlib import Path

import pytest
from support.bench_axis import lay_out

from hil.app.terminal.main import main


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


def test_two_axes_of_one_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(lay_out(tmp_path))
    assert main(["panel", path, path]) == 2
    assert "expected a name for each" in capsys.readouterr().err
