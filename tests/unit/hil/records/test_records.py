"""Record files: what is read back is what was written, and nothing unclean is let in."""

from __future__ import annotations

import math
import string
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.corpus import check_complete, check_refused, expectations

from drivers.errors import InputError
from drivers.files import decode_text
from hil.records.rows import LARGEST, REQUIRED, Records, concatenate, parse_csv, read_csv, to_csv

OPTIONAL = (
    "command_mm",
    "time_s",
    "velocity_mm_s",
    "since_reversal_mm",
    "stroke_mm",
    "motor_mm",
    "torque_percent",
    "load_kg",
    "pitch_urad",
    "yaw_urad",
    "air_temp_c",
    "air_pressure_hpa",
    "air_humidity_percent",
)
CORPUS = Path(__file__).parents[1] / "corpus" / "records"
EXPECTED = expectations(CORPUS)
HEADER = "run,direction,target_mm,measured_mm\n"

believable = st.floats(-LARGEST, LARGEST)
positions = st.floats(-1e5, 1e5)
extra_names = st.one_of(
    st.sampled_from(OPTIONAL),
    st.text(string.ascii_letters + string.digits + "_ µ°#-.", min_size=1, max_size=12).filter(
        lambda name: name == name.strip() and not name.startswith("#") and name not in REQUIRED
    ),
)


@st.composite
def records(draw: st.DrawFn) -> Records:
    count = draw(st.integers(1, 12))

    def column(values: st.SearchStrategy[float]) -> list[float]:
        return draw(st.lists(values, min_size=count, max_size=count))

    columns = {
        "run": column(st.integers(-5, 10**6).map(float)),
        "direction": column(st.sampled_from([1.0, -1.0])),
        "target_mm": column(positions),
        "measured_mm": column(believable),
    }
    for name in draw(st.lists(extra_names, unique=True, max_size=4)):
        columns[name] = column(st.one_of(believable, st.just(math.nan)))
    order = draw(st.permutations(list(columns)))
    return Records.of({name: columns[name] for name in order})


def same_bits(one: Records, other: Records) -> bool:
    return list(one.columns) == list(other.columns) and all(
        np.array_equal(one[name], other[name], equal_nan=True)
        and np.array_equal(np.signbit(one[name]), np.signbit(other[name]))
        for name in one.columns
    )


@given(records(), st.text(string.printable + "µ\u2028\x85", max_size=30))
@settings(max_examples=50)
def test_round_trip_is_bit_exact_in_every_column(rows: Records, comment: str) -> None:
    assert same_bits(parse_csv(to_csv(rows, comment)), rows)


@given(records(), st.sampled_from(["\n", "\r\n", "\r"]), st.booleans())
@settings(max_examples=50)
def test_line_ends_byte_order_mark_and_a_missing_last_line_end_do_not_matter(
    rows: Records, line_end: str, bom: bool
) -> None:
    text = to_csv(rows).rstrip("\n").replace("\n", line_end)
    assert same_bits(parse_csv(decode_text(text.encode("utf-8-sig" if bom else "utf-8"))), rows)


def test_every_file_of_the_corpus_is_expected_and_every_expectation_has_its_file() -> None:
    check_complete(CORPUS, EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_malformed_file_is_refused_in_one_line_that_names_the_place(name: str) -> None:
    check_refused(read_csv, CORPUS / name, EXPECTED[name], longest=200)


def test_a_directory_or_nothing_instead_of_a_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="Is a directory"):
        read_csv(tmp_path)
    with pytest.raises(InputError, match=r"nowhere\.csv: .*No such file"):
        read_csv(tmp_path / "nowhere.csv")


def test_a_file_without_permission_is_named(tmp_path: Path, as_nobody: Callable[[], None]) -> None:
    path = tmp_path / "locked.csv"
    path.write_text(HEADER, encoding="utf-8")
    path.chmod(0)
    as_nobody()
    with pytest.raises(InputError, match=r"locked\.csv: .*Permission denied"):
        read_csv(path)


def test_unknown_columns_and_row_order_are_kept() -> None:
    rows = parse_csv(f"{HEADER.strip()},vibration_g\n2,-1,5,5.001,0.25\n1,+1,0,0.002,\n")
    assert list(rows["run"]) == [2.0, 1.0]
    assert rows["vibration_g"][0] == 0.25
    assert math.isnan(rows["vibration_g"][1])


def test_errors_have_the_sign_of_actual_minus_commanded() -> None:
    rows = Records.of(
        {"run": [1], "direction": [1], "target_mm": [10.0], "measured_mm": [10.004], "command_mm": [10.001]}
    )
    assert rows.error_um == pytest.approx([4.0])
    assert rows.uncorrected_error_um == pytest.approx([3.0])


def test_an_empty_command_means_the_target() -> None:
    rows = parse_csv(f"{HEADER.strip()},command_mm\n1,+1,10,10.004,10.001\n1,-1,10,10.004,\n")
    assert rows.command_mm.tolist() == [10.001, 10.0]
    assert rows.uncorrected_error_um == pytest.approx([3.0, 4.0])


def test_concatenate_fills_what_a_part_lacks() -> None:
    plain = Records.of({"run": [1], "direction": [1], "target_mm": [1.0], "measured_mm": [1.0]})
    corrected = plain.with_column("command_mm", np.array([1.002])).with_column("load_kg", np.array([50.0]))
    both = concatenate([plain, corrected])
    assert both.command_mm.tolist() == [1.0, 1.002]
    assert math.isnan(both["load_kg"][0])
    assert both["load_kg"][1] == 50.0


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"run": [1.5, 1]}, "run"),
        ({"run": [math.nan, 1]}, "run"),
        ({"direction": [0, 1]}, "direction"),
        ({"measured_mm": [math.inf, 0]}, "measured_mm"),
        ({"measured_mm": [0.0]}, "length"),
        ({"measured_mm": [[0.0, 1.0], [0.0, 1.0]]}, "dimensions"),
        ({"measured_mm": ["x", "y"]}, "measured_mm"),
        ({"load_kg": [1e300, 0]}, "load_kg"),
        ({"a,b": [0, 0]}, "a,b"),
        ({"#note": [0, 0]}, "#note"),
        ({"": [0, 0]}, "name"),
    ],
)
def test_columns_that_could_not_be_read_back_are_refused(changed: dict[str, list[float]], said: str) -> None:
    columns = {"run": [1, 1], "direction": [1, -1], "target_mm": [0, 0], "measured_mm": [0, 0]}
    with pytest.raises(InputError, match=said):
        Records.of({**columns, **changed})


def test_columns_cannot_be_written_to_and_do_not_follow_their_source() -> None:
    source = np.array([1.0, 2.0])
    rows = Records.of({"run": [1, 1], "direction": [1, -1], "target_mm": source, "measured_mm": source})
    source[0] = 9.0
    assert rows.target_mm[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        rows.target_mm[0] = 5.0
