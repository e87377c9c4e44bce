"""`hil iso230` and `hil iso230-4`: the figures of ISO 230-2 of a record file, and of ISO 230-4 of circular paths."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from drivers.errors import InputError
from drivers.files import read_text, table_rows
from hil.figures.iso230 import iso230
from hil.figures.iso230_4 import MEANINGS, iso230_4
from hil.figures.verdict import accuracy
from hil.records.files import naming, parse_json, split_lines
from hil.records.rows import UM_PER_MM, Floats, parse_number, read_csv, shown
from hil.ui.terminal.output import number, print_facts, write_json
from hil.ui.terminal.summary import print_figures, print_paths


def run(args: argparse.Namespace) -> int:
    """Prints the figures. Returns 0. Raises InputError for records that cannot give them."""
    with naming(args.records):
        records = read_csv(args.records)
        figures = iso230(records)
    print(accuracy(records, None, None, None))
    print_figures(figures)
    if args.json:
        write_json(args.json, {"records": str(args.records), **figures.as_json()})
    return 0


def run_circle(args: argparse.Namespace) -> int:
    """Prints the figures. Returns 0. Raises InputError for files that hold no circular path, and paths that do not belong together."""
    if len(args.paths) > 2:
        raise InputError(f"{len(args.paths)} paths, expected one, or one of each sense")
    read = []
    for path in args.paths:
        with naming(path):
            text = read_text(path)
            read.append(_driven(text, args.circle) if path.lower().endswith(".json") else _table(text, args.radius))
    radii = {radius for radius, _ in read}
    if len(radii) > 1:
        raise InputError(
            f"the paths have nominal radii of {' and '.join(f'{radius:g}' for radius in sorted(radii))} mm, expected one"
        )
    figures = iso230_4([points for _, points in read], radii.pop())
    print_paths(dict(zip(args.paths, figures.paths, strict=True)))
    if figures.G_b_um is not None:
        facts = {"G(b)": (figures.G_b_um, MEANINGS["G_b"]), "D": (figures.D_um, MEANINGS["D"])}
        print_facts({name: f"{number(value)} µm, {meaning}" for name, (value, meaning) in facts.items()})
    else:
        print("G(b) and D need a path of each sense")
    if args.json:
        write_json(args.json, {"paths": list(args.paths), "iso230_4": figures.as_json()})
    return 0


def _driven(text: str, wanted: str | None) -> tuple[float, tuple[Floats, Floats]]:
    """Nominal radius and points of a circle in the result of `hil circle`."""
    try:
        form: Any = parse_json(text)
        circles = form["circles"]
        name = wanted or list(circles)[-1]
        radius, sense = float(form["radius_mm"]), float(form["sense"])
        if name not in circles:
            raise InputError(f"holds no circle {name!r}, only {', '.join(circles)}")
        angle, deviation = (np.asarray(circles[name][key], dtype=np.float64) for key in ("angle_deg", "deviation_um"))
        if sense not in (1.0, -1.0) or not 0.0 < radius < np.inf or angle.ndim != 1 or angle.shape != deviation.shape:
            raise ValueError("values")
        if not (np.isfinite(angle).all() and np.isfinite(deviation).all()):
            raise ValueError("values")
    except (ValueError, KeyError, TypeError, IndexError) as error:
        raise InputError("is no result of `hil circle --json`") from error
    return radius, _points(angle * sense, deviation, radius)


def _table(text: str, radius: float | None) -> tuple[float, tuple[Floats, Floats]]:
    """Nominal radius and points of a path in CSV."""
    if radius is None:
        raise InputError("says nothing of the nominal radius; state it with --radius MM")
    lines = list(table_rows(split_lines(text)))
    header = lines[0][1] if lines else []
    pair = next((pair for pair in (("x_mm", "y_mm"), ("angle_deg", "deviation_um")) if set(pair) <= set(header)), None)
    if pair is None:
        raise InputError(
            f"header is {','.join(header)}, expected x_mm,y_mm or angle_deg,deviation_um",
            line=lines[0][0] if lines else 1,
        )
    values: tuple[list[float], list[float]] = ([], [])
    for index, cells in lines[1:]:
        if len(cells) != len(header):
            raise InputError(f"row has {len(cells)} columns, expected {len(header)}", line=index)
        for name, into in zip(pair, values, strict=True):
            cell = cells[header.index(name)].strip()
            value = parse_number(cell)
            if value is None or not np.isfinite(value):
                raise InputError(f"{name} is {shown(cell)}, expected a number", line=index)
            into.append(value)
    first, second = np.array(values[0]), np.array(values[1])
    return radius, (first, second) if pair[0] == "x_mm" else _points(first, second, radius)


def _points(angle_deg: Floats, deviation_um: Floats, radius_mm: float) -> tuple[Floats, Floats]:
    away, angle = radius_mm + deviation_um / UM_PER_MM, np.radians(angle_deg)
    return away * np.cos(angle), away * np.sin(angle)
