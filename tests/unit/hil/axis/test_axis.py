"""The axis file: what it says is what is used, and whatever it does not say rightly is refused with its place."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from fractions import Fraction
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.corpus import check_complete, check_refused, expectations

from drivers.errors import InputError
from hil.axis.axis_file import HomingConfig, iso_targets, load_axis
from hil.axis.instrument import FixedAirConfig
from hil.correction.tables import Band, TableMode

CORPUS = Path(__file__).parents[1] / "corpus" / "axis"
EXPECTED = expectations(CORPUS)
EXAMPLE = Path(str(files("hil.examples") / "axis.toml"))


def axis_text(**changed: str) -> str:
    """A good axis file; each keyword replaces the line of that key, or is added to [correction]."""
    lines = EXAMPLE.read_text(encoding="utf-8").splitlines()
    for key, value in changed.items():
        found = [index for index, line in enumerate(lines) if line.startswith(f"{key} =")]
        if found:
            lines[found[0]] = f"{key} = {value}"
        else:
            lines.insert(lines.index("[correction]") + 1, f"{key} = {value}")
    return "\n".join(lines) + "\n"


def test_every_file_of_the_corpus_is_expected_and_every_expectation_has_its_file() -> None:
    check_complete(CORPUS, EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_malformed_file_is_refused_in_one_line_that_names_the_place(name: str) -> None:
    check_refused(load_axis, CORPUS / name, EXPECTED[name], longest=240)


def test_a_directory_or_nothing_instead_of_a_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Is a directory"):
        load_axis(tmp_path)
    with pytest.raises(InputError, match=r"nowhere\.toml: .*No such file"):
        load_axis(tmp_path / "nowhere.toml")


def test_a_file_without_permission_is_named(tmp_path: Path, as_nobody: Callable[[], None]) -> None:
    path = tmp_path / "locked.toml"
    path.write_text(axis_text(), encoding="utf-8")
    path.chmod(0)
    as_nobody()
    with pytest.raises(InputError, match=r"locked\.toml: .*Permission denied"):
        load_axis(path)


def test_the_example_is_what_it_says(tmp_path: Path) -> None:
    path = tmp_path / "axis.toml"
    path.write_text(
        axis_text(
            motor_revs_per_shaft_rev='"5/2"',
            mode='"unidirectional+backlash"',
            band_um="[6, 7.0]",
            builder_key='"keys/b.key"',
            directory='"/var/lib/x"',
        ),
        encoding="utf-8",
    )
    axis = load_axis(path)
    assert (axis.name, axis.limits.travel_max_mm, axis.limits.max_velocity_mm_s) == ("X", 500.0, 100.0)
    assert axis.scaling.motor_revs_per_shaft_rev == Fraction(5, 2)
    assert (axis.drive.backend, axis.drive.interface, axis.drive.node_id) == ("canopen", "socketcan", 1)
    assert axis.instrument.place_temps == {"screw": 4}
    assert len(axis.measurement.targets_mm) == 25
    assert axis.measurement.reference_mm == 10.0
    assert axis.correction.mode is TableMode.UNIDIRECTIONAL_BACKLASH
    assert axis.correction.band == Band(6.0, 7.0)
    assert axis.store.builder_key == tmp_path / "keys/b.key"
    assert axis.store.directory == Path("/var/lib/x")


@pytest.mark.parametrize(
    ("key", "changed", "last_mm"),
    [
        ("[axis] travel_max_mm", {"travel_max_mm": "3000.0", "encoder_counts_per_motor_rev": str(2**23)}, "2560"),
        ("[axis] travel_max_mm", {"encoder_counts_per_motor_rev": str(2**26), "motor_revs_per_shaft_rev": "1"}, "320"),
        ("[axis] travel_min_mm", {"travel_min_mm": "-300.0", "motor_revs_per_shaft_rev": "5000"}, "32.768"),
        ("[drive.homing] home_position_mm", {"# home_position_mm": "-200000.0"}, "163840"),
    ],
)
def test_a_place_that_32_bits_do_not_hold_is_refused_as_the_file_is_read(
    tmp_path: Path, key: str, changed: dict[str, str], last_mm: str
) -> None:
    """epics-modules/ecmc issue 54: a fine encoder on a long axis counts beyond 2^31."""
    path = tmp_path / "axis.toml"
    path.write_text(axis_text(**changed).replace("# home_position_mm = -2", "home_position_mm = -2"), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_axis(path)
    said = str(caught.value)
    assert key in said
    assert f"from -{last_mm} to {last_mm} mm" in said
    assert "[scaling]" in said
    path.write_text(axis_text(encoder_counts_per_motor_rev=str(2**25), motor_revs_per_shaft_rev="1"), encoding="utf-8")
    assert load_axis(path).limits.travel_max_mm == 500.0


def test_what_the_example_calls_a_default_is_one(tmp_path: Path) -> None:
    """Every key with its comment "default", or commented out, may go, and nothing changes but what those lines said."""
    path, bare = tmp_path / "axis.toml", tmp_path / "bare.toml"
    path.write_text(axis_text(), encoding="utf-8")
    kept = (line for line in axis_text().splitlines() if "# default" not in line or line.startswith("place_temps"))
    bare.write_text("\n".join(kept), encoding="utf-8")
    whole, short = load_axis(path), load_axis(bare)
    assert whole.drive == short.drive
    assert whole.instrument == short.instrument


def test_the_optional_tables_of_drive_and_instrument(tmp_path: Path) -> None:
    path = tmp_path / "axis.toml"
    lines = axis_text(heartbeat_s="0", dead_path_mm="-120.5", air_temp_channel="0").splitlines()
    shown = (
        "method",
        "speed_switch_mm_s",
        "speed_zero_mm_s",
        "home_position_mm",
        "temp_c",
        "pressure_hpa",
        "humidity_percent",
    )
    lines = [
        line.removeprefix("# ") if line.startswith(tuple(f"# {key} =" for key in shown)) else line for line in lines
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    axis = load_axis(path)
    assert axis.drive.heartbeat_s is None
    assert axis.drive.homing == HomingConfig(21, 20.0, 1.0, 0.0)
    assert axis.instrument.fixed_air == FixedAirConfig(20.0, 1013.25, 50.0)
    assert (axis.instrument.dead_path_mm, axis.instrument.air_temp_channel) == (-120.5, None)


def test_the_example_for_a_modbus_drive(tmp_path: Path) -> None:
    axis = load_axis(str(files("hil.examples") / "modbus_axis.toml"))
    assert (axis.drive.backend, axis.drive.register_map) == ("modbus", "vendor_style")
    assert (axis.drive.url, axis.drive.unit, axis.drive.baud) == ("tcp://192.168.0.20:502", 1, 19_200)


def test_a_register_map_is_looked_for_beside_the_axis_file(tmp_path: Path) -> None:
    text = (files("hil.examples") / "modbus_axis.toml").read_text(encoding="utf-8")
    path = tmp_path / "axis.toml"
    path.write_text(text.replace('"vendor_style"', '"mine.toml"', 1), encoding="utf-8")
    assert load_axis(path).drive.register_map == str(tmp_path / "mine.toml"), (
        "and named with its place when it is missing"
    )
    (tmp_path / "vendor_style").write_text("")
    path.write_text(text, encoding="utf-8")
    assert load_axis(path).drive.register_map == str(tmp_path / "vendor_style")


def test_a_misspelt_table_that_may_be_left_out_is_named_with_the_one_that_was_meant(tmp_path: Path) -> None:
    path = tmp_path / "axis.toml"
    text = axis_text()
    for name in ("backlash", "lost_motion"):
        path.write_text(text.replace(f"[{name}]", f"[{name[:-1]}]"), encoding="utf-8")
        with pytest.raises(InputError, match=f"unknown key {name[:-1]}, the nearest known one is {name}"):
            load_axis(path)


def test_what_is_varied_is_a_column_with_levels(tmp_path: Path) -> None:
    path = tmp_path / "axis.toml"
    text = axis_text()
    path.write_text(
        text.replace("[conditions]", "[conditions]\nload_kg = [0, 60]\npos_y_mm = [1.5]\n"), encoding="utf-8"
    )
    assert load_axis(path).conditions.levels == {"load_kg": (0.0, 60.0), "pos_y_mm": (1.5,)}
    for line, said in (
        ("load_kg = []", r"load_kg is \[\], expected a list"),
        ("mass_kg = [1]", "mass_kg is mass_kg, expected load_kg or"),
    ):
        path.write_text(text.replace("[conditions]", f"[conditions]\n{line}\n"), encoding="utf-8")
        with pytest.raises(InputError, match=rf"axis\.toml:\d+: \[conditions\] {said}"):
            load_axis(path)


def test_the_specified_value_has_a_sign_for_each_section_and_direction(tmp_path: Path) -> None:
    path = tmp_path / "axis.toml"
    head = axis_text(band_um="[6.0, 7.0]").replace("# signs = ", "signs = ")
    path.write_text(head, encoding="utf-8")
    band = load_axis(path).correction.band
    assert band is not None
    assert [band.at(at, way).middle_um for at in (0.0, 249.9, 250.0) for way in (1, -1)] == [6.5, -6.5] * 2 + [6.5, 6.5]
    signs = next(line for line in head.splitlines() if line.startswith("signs = "))
    for text, words in (
        (head.replace(signs, "signs = [{ from_mm = 5.0, to_mm = 5.0 }]"), "expected from_mm < to_mm"),
        (head.replace(signs, "signs = [{ from_mm = 0.0, to_mm = 5.0, plus = 2 }]"), "plus is 2, expected 1 or -1"),
        (
            head.replace(signs, "signs = [{ from_mm = 0.0, to_mm = 5.0 }, { from_mm = 4.0, to_mm = 9.0 }]"),
            "sections from 4 mm have two signs",
        ),
        (axis_text().replace("# signs = ", "signs = "), "given without band_um"),
        (axis_text(fine_total_um="2.0"), "fine_total_um is 2, expected at least the range of one round, 3"),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=re.escape(words)) as refused:
            load_axis(path)
        assert refused.value.line is not None


def test_defaults(tmp_path: Path) -> None:
    path = tmp_path / "axis.toml"
    text = "\n".join(line for line in axis_text().splitlines() if "# default" not in line)
    path.write_text(text, encoding="utf-8")
    axis = load_axis(path)
    assert axis.correction.band is None
    assert axis.measurement.reference_mm == axis.measurement.targets_mm[0]
    assert axis.store.directory == tmp_path / "X-campaign"
    assert axis.scaling.direction == 1


def test_a_byte_order_mark_and_crlf_do_not_matter(tmp_path: Path) -> None:
    plain, odd = tmp_path / "plain.toml", tmp_path / "odd.toml"
    plain.write_bytes(axis_text().encode())
    odd.write_bytes(b"\xef\xbb\xbf" + axis_text().replace("\n", "\r\n").encode())
    assert load_axis(odd).purpose("calibrate") == load_axis(plain).purpose("calibrate")


@pytest.mark.parametrize(
    ("changed", "same"),
    [
        ({"runs": "4"}, False),
        ({"travel_max_mm": "499.0"}, False),
        ({"feed_mm_per_shaft_rev": "5.0"}, False),
        ({"wavelength_fraction": "4"}, False),
        ({"compensate_air": "false"}, False),
        ({"band_um": "[6.0, 7.0]"}, False),
        ({"fine_total_um": "6.0"}, True),
        ({"fine_total_um": "4.0"}, False),
        ({"seed": "2"}, False),
        ({"port": '"/dev/ttyUSB1"'}, True),
        ({"channel": '"can1"'}, True),
        ({"builder_key": '"other.key"'}, True),
        ({"instrument_agrees_within_um": "300.0", "largest_reversal_um": "50.0"}, True),
    ],
)
def test_the_purpose_of_a_campaign_changes_with_what_decides_its_rows(
    tmp_path: Path, changed: dict[str, str], same: bool
) -> None:
    plain, other = tmp_path / "plain.toml", tmp_path / "other.toml"
    plain.write_text(axis_text(), encoding="utf-8")
    other.write_text(axis_text(**changed), encoding="utf-8")
    purposes = [json.dumps(load_axis(path).purpose("calibrate"), sort_keys=True) for path in (plain, other)]
    assert (purposes[0] == purposes[1]) is same


@given(
    st.floats(-1000, 1000),
    st.floats(1.0, 5000),
    st.integers(2, 60),
    st.floats(0, 0.9),
    st.integers(0, 2**31),
)
@settings(max_examples=200)
def test_targets_ascend_stay_between_the_ends_and_are_not_equally_spaced(
    first: float, length: float, sections: int, share: float, seed: int
) -> None:
    targets = iso_targets(first, first + length, sections, share, seed)
    spacing = length / (sections - 1)
    assert len(targets) == sections
    assert first - 0.001 <= targets[0] <= targets[-1] <= first + length + 0.001
    assert targets == iso_targets(first, first + length, sections, share, seed)
    for index, target in enumerate(targets):
        assert abs(target - (first + index * spacing)) <= share * spacing / 2 + 0.001
    assert all(later - earlier >= (1 - share) * spacing - 0.002 for earlier, later in pairwise(targets))


def test_offsets_are_random_at_each_target() -> None:
    targets = iso_targets(0.0, 480.0, 25, 0.3, 1)
    spacings = [later - earlier for earlier, later in pairwise(targets)]
    assert len({round(spacing, 3) for spacing in spacings}) == 24
    assert targets != iso_targets(0.0, 480.0, 25, 0.3, 2)
