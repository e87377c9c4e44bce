"""Measurements of other programs become the records they were."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.places import SHARED_DATA as DATA

from drivers.errors import InputError
from hil.correction.formats import keysight, lines, measured_csv, renishaw, wide_iso
from hil.correction.formats.keysight import KeysightSettings
from hil.correction.formats.measured_csv import Column, MeasuredCsvSettings, parse_column
from hil.correction.formats.wide_iso import WideIsoSettings
from hil.figures.iso230 import iso230
from hil.records.rows import Records, read_csv

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data at {DATA} (set HIL_SHARED_DATA)")


def campaign(seed: int) -> Records:
    """Bidirectional runs in the order they are measured."""
    rng = np.random.default_rng(seed)
    targets = np.round(np.sort(rng.choice(5000, int(rng.integers(2, 12)), replace=False) / 10.0 - 100), 4)
    rows: list[tuple[float, float, float]] = []
    for run in range(1, int(rng.integers(2, 6))):
        rows += [(run, 1.0, t) for t in targets] + [(run, -1.0, t) for t in targets[::-1]]
    run, direction, target = np.array(rows).T
    error_um = np.round(rng.normal(0, 5, len(rows)), 3)
    return Records.of(
        {"run": run, "direction": direction, "target_mm": target, "measured_mm": target + error_um / 1000}
    )


def same(found: Records, wanted: Records) -> None:
    assert len(found) == len(wanted)
    for name in ("run", "direction", "target_mm"):
        assert np.array_equal(found[name], wanted[name]), name
    assert found.measured_mm == pytest.approx(wanted.measured_mm, abs=1e-9)


# -- Keysight ----------------------------------------------------------------------------------------------------------


def as_lin(records: Records, separator: str = ", ", lines: int = 1) -> str:
    targets = records.target_mm[: len(records) // (2 * len(records.runs))]
    errors = np.array_split(records.error_um, lines)
    head = "Identify=MeaType,Choosing=0\nIdentify=Operator,Text=somebody\n"
    positions = f"Identify=Positions,TextUnit={separator.join(f'{t:.4f}' for t in targets)} mm\n"
    body = "".join(f"Identify=LinearErr,TextUnit={separator.join(f'{e:.3f}' for e in part)} um\r\n" for part in errors)
    return head + positions + body + "Identify=AirTemp,TextUnit=20.1 C\n"


@settings(max_examples=100, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.sampled_from([", ", " ", ";", "\t"]), st.integers(1, 3))
def test_keysight_cycles_run_forward_then_back(seed: int, separator: str, lines: int) -> None:
    wanted = campaign(seed)
    same(keysight.load(as_lin(wanted, separator, lines)), wanted)


@needs_data
def test_keysight_gives_the_published_figures() -> None:
    """The example campaign, written as the file it came from, keeps the figures known of it."""
    records = keysight.load(as_lin(read_csv(DATA / "iso230_example.csv")))
    figures = iso230(records).figures()
    assert {name: f"{figures[name]:.2f}" for name in ("A", "R", "B")} == {"A": "9.59", "R": "6.55", "B": "4.12"}


def test_keysight_units_and_refusals() -> None:
    text = "Identify=Positions,TextUnit=0 1 in\nIdentify=LinearErr,TextUnit=1 2 3 4 um\n"
    records = keysight.load(text)
    assert records.target_mm.tolist() == [0.0, 25.4, 25.4, 0.0]
    assert records.error_um == pytest.approx([1, 2, 3, 4])
    for change, complaint in (
        (("1 2 3 4 um", "1 2 3 um"), "3 errors for 2 positions, expected a multiple of 4"),
        (("4 um", "4"), "ends in '4', expected a unit"),
        (("0 1 in", "0 0 in"), "twice"),
        (("1 2 3", "1 x 3"), "is 'x', expected a number"),
        (("LinearErr", "AngularErr"), "no field LinearErr"),
        (("Positions,TextUnit", "Positions,Text"), "expected TextUnit"),
    ):
        with pytest.raises(InputError, match=complaint):
            keysight.load(text.replace(*change))


@pytest.mark.parametrize(
    "form",
    [
        "Identify={},TextUnit={}",
        'Identify={} "TextUnit={}"',
        "Identify={}\nTextUnit={}",
        'identify = {} , "TextUnit = {}"',
    ],
)
def test_keysight_fields_in_any_punctuation(form: str) -> None:
    lines = [
        form.format("Operator", "somebody"),
        form.format("Positions", "0 10 mm"),
        form.format("LinearErr", "1 2 3 4 um"),
    ]
    records = keysight.load("\r\n".join(lines))
    assert records.target_mm.tolist() == [0.0, 10.0, 10.0, 0.0]
    assert records.error_um == pytest.approx([1, 2, 3, 4])
    with pytest.raises(InputError, match="Positions is given as '', expected TextUnit"):
        keysight.load("Identify=Positions\nIdentify=LinearErr,TextUnit=1 um\n")


def test_keysight_commas_within_numbers_are_never_taken_for_commas_between_them() -> None:
    """Six targets or three? Read as a list, the fields below would fit together and give six."""
    text = "Identify=Positions,TextUnit=0,1 10,5 20,7 mm\nIdentify=LinearErr,TextUnit=1,5 2,5 3,5 3,6 2,6 1,6 um\n"
    with pytest.raises(InputError, match=r"holds '0,1': one number or two\?") as caught:
        keysight.load(text)
    assert caught.value.line == 1
    records = keysight.load(text, KeysightSettings(decimal=","))
    assert records.target_mm.tolist() == [0.1, 10.5, 20.7, 20.7, 10.5, 0.1]
    assert records.error_um == pytest.approx([1.5, 2.5, 3.5, 3.6, 2.6, 1.6])
    same(keysight.load(text.replace(" ", ";"), KeysightSettings(decimal=",")), records)
    with pytest.raises(InputError, match="neither ascend nor descend"):
        keysight.load("Identify=Positions,TextUnit=0,2,1 mm\nIdentify=LinearErr,TextUnit=1,2,3,3,2,1 um\n")


# -- CSV ---------------------------------------------------------------------------------------------------------------


def test_csv_with_other_names_units_and_marks() -> None:
    text = "Lauf;Richtung;Soll;Abw;Temp\n1;up;0,0;1,5;20,1\n1;down;10,5;-2,5;20,2\n"
    chosen = MeasuredCsvSettings(
        dict(
            parse_column(column)
            for column in ("run=Lauf", "direction=Richtung", "target_mm=Soll", "error_um=Abw:um", "temp_screw_c=Temp")
        ),
        decimal=",",
    )
    records = measured_csv.load(text, chosen)
    assert records.direction.tolist() == [1.0, -1.0]
    assert records.target_mm.tolist() == [0.0, 10.5]
    assert records.error_um == pytest.approx([1.5, -2.5])
    assert records["temp_screw_c"].tolist() == [20.1, 20.2]


@pytest.mark.parametrize(
    ("unit", "factor"), [("um", 1e-3), ("IN", 25.4), ("microns", 1e-3), ("m", 1000.0), ("nm", 1e-6), ("", 1.0)]
)
def test_csv_units(unit: str, factor: float) -> None:
    chosen = MeasuredCsvSettings({"measured_mm": Column("measured_mm", unit)})
    records = measured_csv.load("run,direction,target_mm,measured_mm\n1,+,0,2\n", chosen)
    assert records.measured_mm[0] == pytest.approx(2 * factor)


@settings(max_examples=100, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_csv_run_and_direction_from_the_order(seed: int) -> None:
    wanted = campaign(seed)
    rows = zip(wanted.target_mm, wanted.measured_mm, strict=True)
    text = "target_mm\tmeasured_mm\n" + "".join(f"{t!r}\t{m!r}\n" for t, m in ((float(a), float(b)) for a, b in rows))
    same(measured_csv.load(text, MeasuredCsvSettings(infer=True)), wanted)


@pytest.mark.parametrize(
    ("targets", "run", "direction"),
    [
        ("0 5 9", "111", "+++"),
        ("0 5 9 0 5 9 0 5 9", "111222333", "+++++++++"),  # one way; the way back was not measured
        ("9 5 0 9 5 0", "111222", "------"),
        ("0 5 9 5 0 5 9 5 0", "111112222", "+++--++--"),  # there and back, the outer targets once
        ("0 5 9 9 5 0 0 5 9", "111111222", "+++---+++"),
        ("0 9 9 0 0 9 9 0", "11112222", "++--++--"),
        ("0 5 9 1 6 8 2 4 7", "111222333", "+++++++++"),  # every run has targets of its own
        ("0 5 9 0 5 9 9 5 0", "111222222", "++++++---"),  # a way back from the second run on
    ],
)
def test_runs_and_directions_from_the_order(targets: str, run: str, direction: str) -> None:
    at = np.array([float(each) for each in targets.split()])
    found = measured_csv.inferred(at, range(2, 2 + len(at)))
    assert "".join(f"{each:.0f}" for each in found[0]) == run
    assert "".join("+" if each > 0 else "-" for each in found[1]) == direction


@pytest.mark.parametrize(
    ("targets", "line"),
    [
        ("1 1 2", 2),
        ("0 9 0 9 0 9", 4),  # two targets: one way, or there and back
        ("0 5 9 0", 5),  # the last reading is a run begun, or a way back of one target
        ("0 5 9 5", 5),
        ("0 5 9 9", 5),
        ("0 5 9 9 0 5 9 9", 6),
        ("0 5 9 5 9", 5),
    ],
)
def test_an_order_that_does_not_say_the_direction_is_refused(targets: str, line: int) -> None:
    at = np.array([float(each) for each in targets.split()])
    with pytest.raises(InputError, match=r"direction cannot be inferred|state run and direction") as caught:
        measured_csv.inferred(at, range(2, 2 + len(at)))
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("text", "chosen", "complaint", "line"),
    [
        ("a,b\n1,2\n", MeasuredCsvSettings(), "header lacks 'target_mm'", 1),
        ("target_mm,measured_mm\n1,2\n", MeasuredCsvSettings(), "lacks 'run' .* inferred", 1),
        ("run,direction,target_mm,measured_mm\n1,+,2\n", MeasuredCsvSettings(), "3 columns, expected 4", 2),
        ("run,direction,target_mm,measured_mm\n1,0,2,2\n", MeasuredCsvSettings(), "direction is '0'", 2),
        ("run,direction,target_mm,measured_mm\n#\n1,+,2,\n", MeasuredCsvSettings(), "measured_mm is ''", 3),
        ("run,direction,target_mm,measured_mm\n1.5,+,2,2\n", MeasuredCsvSettings(), "whole number", 2),
        ("run,run,target_mm,measured_mm\n1,1,2,2\n", MeasuredCsvSettings(), "twice", 1),
        ("sep=,\nrun;direction;target_mm;measured_mm\n1;+;2;2\n", MeasuredCsvSettings(), "names the delimiter ','", 1),
        (
            "run;direction;place;\n;;target_mm;measured_mm\n1;+;2;2\n",
            MeasuredCsvSettings(),
            "lacks 'target_mm' .*one line",
            1,
        ),
        ("target_mm;9\nrun;direction;target_mm\n1;+;2\n", MeasuredCsvSettings(), "lacks 'measured_mm'", 2),
        ("only\n1\n", MeasuredCsvSettings(), "name the delimiter", 1),
        ("run,direction,target_mm,measured_mm\n1,+,2," + "2" * 200_000 + "\n", MeasuredCsvSettings(), "no row", 2),
    ],
)
def test_csv_refusals_name_the_line(text: str, chosen: MeasuredCsvSettings, complaint: str, line: int | None) -> None:
    with pytest.raises(InputError, match=complaint) as caught:
        measured_csv.load(text, chosen)
    assert caught.value.line == line


@pytest.mark.parametrize(
    ("cell", "decimal", "expected"),
    [
        ("\N{MINUS SIGN}1.5", ".", -1.5),
        ("\N{MINUS SIGN}1,5", ",", -1.5),
        ("1e1", ".", 10.0),
        ("1,5", ".", "expected a number; with another decimal mark"),
        ("1.5", ",", "expected a number; with another decimal mark"),
        ("1.000,5", ",", "'1.000,5', expected a number$"),
        ("1_0", ".", "expected a number$"),
        ("\N{ARABIC-INDIC DIGIT ONE}", ".", "expected a number$"),
        ("nan", ".", "expected a number$"),
        ("1e999", ".", "expected a number$"),
    ],
)
def test_a_number_is_read_as_it_was_meant_or_not_at_all(cell: str, decimal: str, expected: float | str) -> None:
    wide = f"target;1+\n{cell};0\n", lambda text: wide_iso.load(text, WideIsoSettings(decimal=decimal))
    names = "run;direction;target_mm;measured_mm"
    long = f"{names}\n1;+;{cell};0\n", lambda text: measured_csv.load(text, MeasuredCsvSettings(decimal=decimal))
    for text, load in (wide, long):
        if isinstance(expected, float):
            assert load(text).target_mm.tolist() == [expected]
            continue
        with pytest.raises(InputError, match=expected) as caught:
            load(text)
        assert caught.value.line == 2


def test_csv_columns_are_checked() -> None:
    for bad in ("target_mm", "=x", "target_mm="):
        with pytest.raises(InputError, match="expected NAME=HEADER"):
            parse_column(bad)
    with pytest.raises(InputError, match="expected such as mm"):
        MeasuredCsvSettings({"target_mm": Column("x", "furlong")})
    with pytest.raises(InputError, match="not both"):
        MeasuredCsvSettings({"measured_mm": Column("a"), "error_um": Column("b")})
    with pytest.raises(InputError, match="is no length"):
        MeasuredCsvSettings({"run": Column("x", "mm")})


# -- wide --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("label", ["{run}{sign}", "run {run} {word}", "{word} {run}", "{arrow}{run}"])
@pytest.mark.parametrize("cells", ["deviation_um", "deviation_mm", "position_mm"])
def test_wide_table_in_any_heading(label: str, cells: str) -> None:
    wanted = campaign(11)
    runs, targets = wanted.runs, np.unique(wanted.target_mm)
    names = {1: {"sign": "+", "word": "forward", "arrow": "↑"}, -1: {"sign": "-", "word": "reverse", "arrow": "↓"}}
    columns = [(run, direction) for direction in (1, -1) for run in runs]
    lines = ["target;" + ";".join(label.format(run=run, **names[direction]) for run, direction in columns)]
    for target in targets[::-1]:
        row = []
        for run, direction in columns:
            at = (wanted.run == run) & (wanted.direction == direction) & (wanted.target_mm == target)
            measured = float(wanted.measured_mm[at][0])
            value = {
                "deviation_um": (measured - target) * 1000,
                "deviation_mm": measured - target,
                "position_mm": measured,
            }[cells]
            row.append(f"{value:.9f}".replace(".", ","))
        lines.append(f"{target:.4f}".replace(".", ",") + ";" + ";".join(row))
    same(wide_iso.load("\n".join(lines), WideIsoSettings(cells, decimal=",")), wanted)


@pytest.mark.parametrize(
    ("text", "complaint", "line"),
    [
        ("target,1+,1-\n0,1,\n", "1- is '', expected a number", 2),
        ("target,1+,1+\n0,1,2\n", "twice", 1),
        ("target,first\n0,1\n", "names no run and direction", 1),
        ("target,1+\n0,1\n0,2\n", "a second time", 3),
        ("target,1+\n0,1,2\n", "3 columns, expected 2", 2),
        ("target\n0\n", "name the delimiter", 1),
        ("target,1+\n", "holds no table", None),
    ],
)
def test_wide_refusals_name_the_line(text: str, complaint: str, line: int | None) -> None:
    with pytest.raises(InputError, match=complaint) as caught:
        wide_iso.load(text)
    assert caught.value.line == line


def rtl(records: Records, flags: str = "0 0 2 0") -> str:
    """Records in the layout of an .rtl file, written from its description: one run number for each way."""
    targets = np.unique(records.target_mm)
    lines = [
        "HEADER::",
        "File type  : rtl",
        "Owner      : Linear",
        "Version no : V20",
        "",
        "TARGET DATA::",
        "Filetype  : ISO",
    ]
    lines += [f"Target-count: {len(targets)}", "Targets :"]
    lines += [" ".join(f"{t:.6f}" for t in targets[at : at + 5]) + " " for at in range(0, len(targets), 5)]
    lines += [f"Flags: {flags}", "", "USER-TEXT::", "Machine: M", "Date:2026-01-01 10:00:00", "", "RUNS::"]
    way = 2 * records.run.astype(int) - (records.direction > 0)
    order = {int(w): n for n, w in enumerate(sorted(set(way.tolist())), start=1)}
    lines += [f"Run-count: {len(order)}", "", "DEVIATIONS::", "Run Target Data:"]
    numbers = np.searchsorted(targets, records.target_mm) + 1
    error = (records.measured_mm - records.target_mm) * 1000
    lines += [f"{order[int(w)]}   {n}      {e:.6f}" for w, n, e in zip(way, numbers, error, strict=True)]
    return "\r\n".join([*lines, "", "ENVIRONMENT::", "Air temp   : 20.1", "", "EOF::", ""])


@given(seed=st.integers(0, 10_000))
@settings(max_examples=40)
def test_an_rtl_file_is_the_campaign_that_it_was_written_from(seed: int) -> None:
    same(renishaw.load(rtl(campaign(seed))), campaign(seed))


def test_an_rtl_file_by_hand() -> None:
    """Two targets, there and back twice: deviations of +1 and +2 µm there, -1 and -2 back, 0.5 µm more the second time."""
    text = (
        "HEADER::\nOwner : Linear\n\nTARGET DATA::\nTarget-count: 2\nTargets :\n 0.0 \n 100.0 \nFlags: 0 0 2 0\n"
        "RUNS::\nRun-count: 4\nDEVIATIONS::\nRun Target Data:\n"
        "1 1 1.0\n1 2 2.0\n2 2 -2.0\n2 1 -1.0\n3 1 1.5\n3 2 2.5\n4 2 -1.5\n4 1 -0.5\nEOF::\n"
    )
    records = renishaw.load(text)
    assert records.run.tolist() == [1, 1, 1, 1, 2, 2, 2, 2]
    assert records.direction.tolist() == [1, 1, -1, -1, 1, 1, -1, -1]
    assert records.target_mm.tolist() == [0, 100, 100, 0, 0, 100, 100, 0]
    assert (records.error_um).tolist() == pytest.approx([1, 2, -2, -1, 1.5, 2.5, -1.5, -0.5], abs=1e-6)
    reversal_um = iso230(records).B
    assert reversal_um == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("Target-count: 2", "Target-count: 3"), "Target-count says 3"),
        (("Run-count: 4", "Run-count: 5"), "Run-count says 5"),
        (("1 2 2.0", "1 3 2.0"), "none of the 2"),
        (("1 2 2.0", "1 2"), "2 columns"),
        (("1 2 2.0\n", ""), "1 readings"),
        (("2 2 -2.0\n2 1", "2 2 -2.0\n2 2"), "not in order"),
        (("Targets :\n 0.0", "Targets :\n x"), "a target"),
        (("Owner : Linear", "Owner : Angular"), "no lengths along the axis"),
        (("Flags: 0 0 2 0", "Flags: 0 1 2 0"), "filled with zeros"),
        (("Run Target Data:", "Position   \tBidirectional Avg Error"), "averages"),
        (("DEVIATIONS::", "OTHER::"), "no readings"),
    ],
)
def test_an_rtl_file_that_is_not_whole_is_refused(change: tuple[str, str], said: str) -> None:
    text = (
        "HEADER::\nOwner : Linear\n\nTARGET DATA::\nTarget-count: 2\nTargets :\n 0.0 \n 100.0 \nFlags: 0 0 2 0\n"
        "RUNS::\nRun-count: 4\nDEVIATIONS::\nRun Target Data:\n"
        "1 1 1.0\n1 2 2.0\n2 2 -2.0\n2 1 -1.0\n3 1 1.5\n3 2 2.5\n4 2 -1.5\n4 1 -0.5\nEOF::\n"
    )
    assert change[0] in text
    with pytest.raises(InputError, match=said):
        renishaw.load(text.replace(*change))


PATTERN = r"^\d+ +(?P<target_mm>\S+) +(?P<error_um>\S+)(?: +(?P<temp_screw_c>\S+) °C)$"


def listing(records: Records) -> str:
    rows = [
        f"{n} {t:.4f} {1000 * (m - t):.4f} 20.{n % 10} °C"
        for n, (t, m) in enumerate(zip(records.target_mm, records.measured_mm, strict=True))
    ]
    return "\n".join(["Listing of a laser", "No  target  error  temp", *rows, "", "end"])


@given(seed=st.integers(0, 10_000))
@settings(max_examples=20)
def test_lines_by_a_pattern_are_the_campaign_that_they_list(seed: int) -> None:
    """Run and direction are in no line: they are read from the order of the targets."""
    found = lines.load(listing(campaign(seed)), lines.LinesSettings(PATTERN))
    same(found, campaign(seed))
    assert found["temp_screw_c"][0] == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("pattern", "said"),
    [
        ("(", "no regular expression"),
        (r"(?P<error_um>\S+)", "needs one group target_"),
        (r"(?P<target_mm>\S+) (?P<error_um>\S+) (?P<measured_mm>\S+)", "needs one group measured_"),
        (r"(?P<target_miles>\S+) (?P<error_um>\S+)", "needs one group target_"),
    ],
)
def test_a_pattern_that_names_no_positions_is_refused(pattern: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        lines.LinesSettings(pattern)


def test_a_line_within_the_rows_is_never_skipped() -> None:
    text = listing(campaign(1)).replace("\n3 ", "\n# 3 ")
    with pytest.raises(InputError, match="does not match the pattern") as caught:
        lines.load(text, lines.LinesSettings(PATTERN))
    assert caught.value.line == 6
    with pytest.raises(InputError, match="0 lines that match"):
        lines.load("nothing\nhere\n", lines.LinesSettings(PATTERN))
