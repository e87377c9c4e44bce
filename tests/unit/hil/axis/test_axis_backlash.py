"""The [backlash] section: defaults, what is refused and how it is said."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.errors import InputError
from hil.axis.axis_file import load_axis, load_drive_axis
from hil.axis.backlash import SLIDE_MM, SLIDES, default_backlash, object_key

HEAD = """[axis]
name = "X"
travel_min_mm = 0.0
travel_max_mm = 100.0
max_velocity_mm_s = 50.0
max_acceleration_mm_s2 = 500.0

[scaling]
encoder_counts_per_motor_rev = 10_000
feed_mm_per_shaft_rev = 10.0

[drive]
backend = "canopen"
node_id = 3
"""
MODBUS = HEAD.replace(
    'backend = "canopen"\nnode_id = 3', 'backend = "modbus"\nurl = "tcp://127.0.0.1:502"\nregister_map = "vendor_style"'
)


def written(tmp_path: Path, section: str, head: str = HEAD) -> Path:
    path = tmp_path / "axis.toml"
    path.write_text(f"{head}\n[backlash]\n{section}", encoding="utf-8")
    return path


def test_an_axis_without_the_section_or_an_instrument_has_defaults(tmp_path: Path) -> None:
    path = tmp_path / "axis.toml"
    path.write_text(HEAD, encoding="utf-8")
    axis = load_drive_axis(path)
    assert axis.backlash is None
    how = default_backlash(axis.path, axis.limits, axis.scaling, axis.drive.backend)
    assert (how.reference_plus_mm, how.reference_minus_mm) == (50.0, 50.0)
    assert (how.step_um, how.steps, how.method, how.parameter) == (1.0, 200, "fitted", None)
    assert load_drive_axis(written(tmp_path, "")).backlash == how
    rest = (how.run_in_mm, how.readings, how.settle_s, how.velocity_mm_s, how.travel_velocity_mm_s, how.runs, how.home)
    assert rest == (0.5, 4, 0.1, 0.5, 10.0, 1, True)  # a fifth of the axis's 50 mm/s on the way
    assert (how.parameter_um, how.acceleration, SLIDES, SLIDE_MM) == (1.0, None, 8, 0.1)
    off_centre = tmp_path / "other.toml"
    off_centre.write_text(HEAD.replace("travel_min_mm = 0.0", "travel_min_mm = -20.0"), encoding="utf-8")
    other = load_drive_axis(off_centre)
    middle = default_backlash(other.path, other.limits, other.scaling, other.drive.backend)
    assert (middle.reference_plus_mm, middle.reference_minus_mm) == (40.0, 40.0)


def test_the_ways_of_both_directions(tmp_path: Path) -> None:
    section = "reference_plus_mm = 80.0\nreference_minus_mm = 20.0\nrun_in_mm = 2.0\nstep_um = 2.0\nsteps = 100\n"
    how = load_drive_axis(written(tmp_path, section)).backlash
    assert how is not None
    reach = 1.0  # 100 steps of 2 µm and eight slides of 0.1 mm
    assert (how.start_mm(-1), how.turning_mm(-1), how.end_mm(-1)) == pytest.approx((78.0, 80.0, 80.0 - reach))
    assert (how.start_mm(1), how.turning_mm(1), how.end_mm(1)) == pytest.approx((22.0, 20.0, 20.0 + reach))


@pytest.mark.parametrize(
    ("text", "key"),
    [("2201h", (0x2201, 0)), ("2201h:1F", (0x2201, 31)), ("2201", None), ("backlash", None), ("22G1h", None)],
)
def test_objects_and_names(text: str, key: tuple[int, int] | None) -> None:
    assert object_key(text) == key


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("step_um = 0.5\n", "step_um is 0.5, expected at least one count, 1 µm"),
        ("steps = 3\n", "steps is 3, expected a whole number, 20 to 5000"),
        ("velocity_mm_s = 60.0\n", "velocity_mm_s is 60, expected at most 50"),
        ("travel_velocity_mm_s = 51.0\n", "travel_velocity_mm_s is 51, expected at most 50"),
        (
            "reference_plus_mm = 0.9\n",
            "reference_plus_mm is 0.9: its run-in and steps from -0.1 to 0.9 mm leave the travel",
        ),
        ("reference_minus_mm = 99.8\n", "leave the travel 0 to 100 mm"),
        ('method = "best"\n', "method is best, expected fitted or four-sample"),
        ('parameter = "backlash"\n', 'expected an object such as "2201h" or "2201h:01"'),
        ("parameter_um = 0\n", "parameter_um is 0, expected a number > 0 in µm"),
        ("speed = 1.0\n", "[backlash] unknown key speed"),
        ('acceleration = "switch"\n', 'expected an object such as "2201h" or "2201h:01"'),
        ("run_in_mm = 0.04\n", "expected mm, 0.05 to 100"),
        ("run_in_mm = 101\n", "expected mm, 0.05 to 100"),
        ("step_um = 0.009\n", "expected µm, 0.01 to 100"),
        ("step_um = 101\n", "expected µm, 0.01 to 100"),
        ("steps = 19\n", "20 to 5000"),
        ("steps = 5001\n", "20 to 5000"),
        ("readings = 0\n", "1 to 100"),
        ("readings = 101\n", "1 to 100"),
        ("settle_s = -0.1\n", "seconds, 0 to 10"),
        ("settle_s = 10.1\n", "seconds, 0 to 10"),
        ("velocity_mm_s = 0\n", "velocity_mm_s is 0, expected a number > 0"),
        ("runs = 0\n", "1 to 100"),
        ("runs = 101\n", "1 to 100"),
    ],
)
def test_what_is_refused_with_its_line(tmp_path: Path, section: str, words: str) -> None:
    with pytest.raises(InputError) as caught:
        load_drive_axis(written(tmp_path, section))
    assert words in str(caught.value)
    assert caught.value.line == len(HEAD.splitlines()) + 3


@pytest.mark.parametrize(
    "section",
    [
        "step_um = 1.0\n",  # just a count: 10 mm / 10 000
        "velocity_mm_s = 50.0\ntravel_velocity_mm_s = 50.0\n",
        # 200 steps of 1 µm and 8 slides of 0.1 mm: 1 mm back from the turn, 0.5 mm of run-in before it
        "reference_plus_mm = 1.0\nreference_minus_mm = 99.0\n",
        "reference_plus_mm = 100.0\nreference_minus_mm = 0.0\nrun_in_mm = 100.0\n",
        'parameter = "2201h:01"\nacceleration = "2202h"\nhome = false\nmethod = "four-sample"\n',
        "run_in_mm = 0.05\nsteps = 20\nreadings = 1\nsettle_s = 0\nruns = 1\n",
        "step_um = 2\nsteps = 5000\nreadings = 100\nsettle_s = 10\nruns = 100\n",
    ],
)
def test_what_is_just_within_bounds_is_taken(tmp_path: Path, section: str) -> None:
    assert load_drive_axis(written(tmp_path, section)).backlash is not None


def test_a_register_of_a_modbus_drive_goes_by_its_name(tmp_path: Path) -> None:
    how = load_drive_axis(written(tmp_path, 'parameter = "backlash"\n', MODBUS)).backlash
    assert how is not None
    assert how.parameter == "backlash"


def test_an_axis_that_is_measured_may_have_the_section_too(tmp_path: Path) -> None:
    measured = '[instrument]\nport = "/dev/null"\n[measurement]\ntargets_mm = [10.0, 20.0]\nvelocity_mm_s = 10.0\n'
    path = written(tmp_path, "runs = 3\n", HEAD + measured)
    axis = load_axis(path)
    assert axis.backlash is not None
    assert axis.backlash.runs == 3


def test_the_shipped_example_is_one() -> None:
    axis = load_drive_axis(Path(__file__).parents[4] / "hil/examples/backlash_axis.toml")
    assert axis.backlash is not None
    assert axis.backlash.parameter == "2201h"
