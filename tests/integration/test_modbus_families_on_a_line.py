"""Makers' Modbus drives on a serial line: RTU frames by umodbus over a pseudo-terminal, from `hil scan` to a move."""

from __future__ import annotations

from pathlib import Path

import pytest
from study.modbus_families import FEED_MM, LIMITS, exercise
from support.maker_drives import FAMILIES, LichuanA6, served_on_a_line

from drivers.modbus.map_loader import load_drive_map
from hil.app.main import main
from hil.axis.axis_file import load_axis
from hil.machine.axis_lock import modbus_endpoint
from sim_backends.clock import SimClock

pytestmark = pytest.mark.outside

SERIAL_ONLY = ("leadshine_el7", "lichuan_a6", "stepperonline_a6_rs", "aasd_15a")


@pytest.mark.parametrize("name", SERIAL_ONLY)
def test_a_family_does_on_a_line_what_it_does_over_tcp(name: str) -> None:
    result = exercise(name, "umodbus")
    assert abs(result.speed_percent) < 1.0
    assert abs(result.distance_mm) < 0.002
    assert abs(result.stop_mm) < 3.0
    assert result.changed == ()
    assert result.homing == "yes"


def test_a_scan_and_a_first_axis_file_over_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    baud = str(load_drive_map("lichuan_a6").registers.bus.baud)
    maker = LichuanA6(SimClock())
    with served_on_a_line(maker, int(baud)) as (port, server):
        line = f"{port}?parity=N"  # a pseudo-terminal refuses the parity that the drive has
        where = ["--serial", line, "--baud", baud]
        assert main(["scan", *where, "--units", "1-3", "--map", "lichuan_a6"]) == 0
        said = capsys.readouterr().out
        assert f'hil drives new X.toml --drive lichuan_a6 --serial "{line}" --baud {baud} --unit 1' in said
        path = tmp_path / "X.toml"
        known = [f"--travel={LIMITS.travel_min_mm:g},{LIMITS.travel_max_mm:g}", "--max-velocity", "200"]
        known += ["--max-acceleration", "2000", "--feed", f"{FEED_MM:g}", "--instrument-port", "/dev/null"]
        assert main(["drives", "new", str(path), "--drive", "lichuan_a6", "--serial", line, *known]) == 0
        assert server.requests > 3
        assert maker.memory() == maker.found
    axis = load_axis(path)
    endpoint = modbus_endpoint(axis)
    assert (endpoint.baud, endpoint.parity) == (int(baud), "N")  # type: ignore[union-attr]
    assert axis.scaling.encoder_counts_per_motor_rev == FAMILIES["lichuan_a6"].counts_per_rev
