"""The machine file: every key is read or refused, and every place is held against the axis files' limits before anything moves."""

from __future__ import annotations

from pathlib import Path

import pytest
from support import probe_files

from drivers.errors import InputError
from hil.probe.machine_file import load_probe_machine

EXAMPLE = Path(__file__).parents[4] / "hil/examples/probe_machine.toml"


def test_the_example_shows_every_default_as_it_is(tmp_path: Path) -> None:
    shown = load_probe_machine(EXAMPLE)
    path = tmp_path / "mill.toml"
    for axis in ("probe_x.toml", "probe_y.toml", "probe_spindle.toml"):
        (tmp_path / axis).write_text(EXAMPLE.with_name(axis).read_text())
    needed = ("[machine]", "[probe]", "[block]", "[bore]", "[bench]", "seed =", "name =", "x =", "y =", "spindle =")
    needed += ("face_mm", "start_mm", "y_mm", "search_mm", "x_mm", "reach_mm", "tip_radius_mm", "radius_limit_um")
    before, _, rest = EXAMPLE.read_text().partition("[face]")
    text = before + rest[rest.index("[store]") :]
    path.write_text("\n".join(line for line in text.splitlines() if line.startswith(needed)))
    plain = load_probe_machine(path)
    assert (plain.probe, plain.block, plain.bore) == (shown.probe, shown.block, shown.bore)
    assert plain.codes == shown.codes
    assert set(shown.features) == {"face", "angle", "boss", "reference"}
    assert (plain.orientation, plain.home, plain.store.sealed) == (shown.orientation, shown.home, shown.store.sealed)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("face_mm = 105.0", "face_mm = 105.0\nfase = 1", r"mill\.toml:\d+: \[block\] unknown key fase"),
        ("[bore]", "[boore]", "unknown key boore"),
        ('y = "Y.toml"', 'y = "X.toml"', "names the same axis file as another axis"),
        ('y = "Y.toml"', "", "y_mm is given, but .machine. names no y axis"),
        ("start_mm = 101.0", "start_mm = 300.0", "start_mm leads axis X out of its limits"),
        ("search_mm = 3.0", "search_mm = 100.0", "search_mm leads axis X out of its limits"),
        ("start_mm = 101.0", "start_mm = 105.0", "start_mm is face_mm, 105"),
        ("search_mm = 3.0", "search_mm = 3.0\nfree_mm = 3.0", "free_mm is 3, expected less than search_mm, 3"),
        ("velocity_deg_s = 180.0", "velocity_deg_s = 1e6", "expected at most 360, the limit of axis S"),
        ("velocity_deg_s = 180.0", "zero_deg = 500.0", "zero_deg leads axis S out of its limits"),
        ("tip_radius_mm = 2.0", "touch_mm_s = 101.0", "touch_mm_s is 101, expected at most 100"),
        ("tip_radius_mm = 2.0", "pulse_mm = 0.000001", "pulse_mm is 1e-06 mm, expected at least one count of axis X"),
        ("tip_radius_mm = 2.0", 'mode = "guess"', "mode is guess, expected latch or step"),
        ("search_mm = 3.0", "search_mm = -3.0", "search_mm is -3.0, expected a number > 0"),
        ("tip_radius_mm = 2.0", "\n[block]\nradius_limit_um = 3", "is not TOML"),
        ("reach_mm = 8.0", "reach_mm = 80.0", "x_mm leads axis X out of its limits"),
        ('spindle = "S.toml"', 'spindle = "T.toml"', "T.toml: cannot be read"),
        ("[block]", "[spindel]\n[block]", "unknown key spindel"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = probe_files.lay_out(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        load_probe_machine(path)


def test_a_radius_limit_needs_a_radius(tmp_path: Path) -> None:
    path = probe_files.lay_out(tmp_path, block="radius_limit_um = 3.0")
    path.write_text(path.read_text().replace("tip_radius_mm = 2.0", ""))
    with pytest.raises(InputError, match="radius_limit_um needs"):
        load_probe_machine(path)


def test_a_machine_is_on_the_bench_or_not(tmp_path: Path) -> None:
    path = probe_files.lay_out(tmp_path)
    axis = tmp_path / "Y.toml"
    axis.write_text(axis.read_text().replace('backend = "bench"\nface = "virtual"', 'backend = "canopen"\nnode_id = 3'))
    with pytest.raises(InputError, match="on the bench and another axis is not"):
        load_probe_machine(path)


def test_without_y_there_is_no_bore_and_no_m92(tmp_path: Path) -> None:
    path = probe_files.lay_out(tmp_path)
    text = path.read_text().replace('y = "Y.toml"', "").replace("y_mm = 40.0", "")
    path.write_text(text[: text.index("[bore]")])
    config = load_probe_machine(path)
    assert list(config.axes) == ["x", "spindle"]
    for asked in (lambda: config.require_y("M92"), config.require_bore):
        with pytest.raises(InputError):
            asked()
