"""`hil sim` as real processes on loopback: what it says, who can reach it, and how it ends."""

from __future__ import annotations

import json
import signal
import socket
from pathlib import Path

import pytest
from support.sim_process import sim

from drivers.clock import WallClock
from drivers.instruments.serial_link import SerialLink
from drivers.instruments.umd_laser import UmdLaser
from hil.app.main import main
from hil.axis.axis_file import load_axis

pytestmark = pytest.mark.outside


def test_a_laser_alone_shows_an_axis_that_shuttles() -> None:
    with sim("laser", "--rate", "200") as laser:
        assert laser.place["drive"] is None
        seen: list[float] = []
        clock = WallClock()
        with UmdLaser(SerialLink(laser.place["laser"]["port"]), clock) as reader:
            deadline = clock.deadline(30.0)
            while not deadline.expired and not (seen and max(seen) - min(seen) > 1.0):
                seen += [reading.position_mm for reading in reader.poll() if reading.position_mm is not None]
                clock.sleep_s(0.05)
        assert max(seen) - min(seen) > 1.0
        assert laser.end(signal.SIGINT) == 0
        assert laser.errors == ""
        assert laser.left is not None


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_machine_over_modbus_tcp_says_where_it_is_and_ends_when_told(number: int, tmp_path: Path) -> None:
    path = tmp_path / "S.toml"
    (tmp_path / "S-campaign").mkdir()
    with sim("modbus", "--tcp", "127.0.0.1:0", "--laser", "--machine", "ideal", "--axis-file", str(path)) as machine:
        axis = load_axis(path)
        assert axis.name == "S", "its campaigns are not in the folder of another axis"
        assert axis.drive.url == machine.place["drive"]["url"]
        assert axis.instrument.port == machine.place["laser"]["port"]
        host, port = axis.drive.url.removeprefix("tcp://").split(":")
        assert host == "127.0.0.1"
        with socket.create_connection((host, int(port)), timeout=10.0) as client:
            client.sendall(bytes.fromhex("0001 0000 0006 01 03 2000 0001"))  # statusword
            reply = client.recv(64)
        assert reply[:8] == bytes.fromhex("0001 0000 0005 01 03")
        assert int.from_bytes(reply[9:11], "big") & 0x004F == 0x0040  # switch on disabled
        assert machine.end(number) == 0
        assert machine.left == {"powered": False, "moving": False, "fault_code": 0, "position_mm": 0.0}
        assert "S-campaign has measurements of another machine" in machine.errors


def test_the_faults_asked_for_happen_on_the_wire(capsys: pytest.CaptureFixture[str]) -> None:
    with sim("modbus", "--tcp", "127.0.0.1:0", "--fault", "no-reply#2") as machine:
        scan = ["scan", "--tcp", machine.place["drive"]["url"], "--units", "1", "--timeout", "5"]
        assert [main(scan) for _ in range(3)] == [0, 1, 0], "the second request is not answered"
    with sim("drive", "--interface", "slcan-pty", "--fault", "node-dead@0") as machine:
        place = machine.place["drive"]
        where = ["--interface", place["interface"], "--channel", place["channel"], "--nodes", str(place["node_id"])]
        assert main(["scan", *where, "--timeout", "1"]) == 1
    assert "no device answers" in capsys.readouterr().out


def test_a_port_in_use_is_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        assert main(["sim", "modbus", "--tcp", address]) == 1
    error = capfd.readouterr().err
    assert error.count("\n") == 1
    assert address in error


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["drive", "--interface", "udp_multicast"], "--allow-outside"),
        (["drive", "--interface", "virtual"], "this process only"),
        (["drive", "--interface", "slcan-pty", "--node", "0"], "--node is 0"),
        (["modbus", "--tcp", "0.0.0.0:0"], "from outside"),
        (["modbus", "--tcp", "127.0.0.1"], "expected host:port"),
        (["modbus", "--pty", "--unit", "248"], "unit id is 248, expected 1 to 247"),
        (["modbus", "--pty", "--axis-file", "X.toml"], "needs --laser"),
        (["modbus", "--pty", "--fault", "heartbeat-stops@3"], "unknown kind heartbeat-stops"),
        (["laser", "--effect", "nonsense=3"], "cannot be switched on"),
        (["laser", "--effect", "backlash"], "expected ID=UM"),
        (["laser", "--rate", "0"], "--rate is 0"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(
    arguments: list[str], words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["sim", *arguments]) == 2
    out, error = capfd.readouterr()
    assert words in error
    assert error.count("\n") == 1
    assert out == ""


def test_an_axis_file_that_is_there_is_left_alone(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "real.toml"
    path.write_text("mine")
    assert main(["sim", "modbus", "--pty", "--laser", "--axis-file", str(path)]) == 2
    assert path.read_text() == "mine"
    assert "exists already" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("stem", "name"), [("-2", "_2"), (".bench", "_bench"), ("Achse 1", "Achse_1"), ("long" * 20, ("long" * 20)[:59])]
)
def test_an_axis_file_of_any_name_is_one_that_can_be_read(stem: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / f"{stem}.toml"
    assert main(["sim", "modbus", "--pty", "--laser", "--for", "0.05", "--axis-file", str(path)]) == 0
    assert load_axis(path).name == name


def test_it_ends_by_itself_after_the_seconds_asked_for(capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", "drive", "--interface", "slcan-pty", "--laser", "--for", "0.1"]) == 0
    first, last = map(json.loads, capfd.readouterr().out.splitlines())
    assert first["drive"]["interface"] == "slcan"
    assert Path(first["drive"]["channel"]).is_relative_to("/dev")
    assert last["left"]["powered"] is False
    assert main(["sim", "modbus", "--pty", "--for", "0.1"]) == 0
    assert json.loads(capfd.readouterr().out.splitlines()[0])["laser"] is None
