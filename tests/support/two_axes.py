"""Axis files of a machine with two axes on the bench, for measuring lost motion and driving circles, with the builder's keys."""

from __future__ import annotations

from pathlib import Path

from support.bench_axis import lay_out

FACES = {
    "virtual": 'face = "virtual"',
    "canopen": 'face = "canopen"',
    "modbus-tcp": 'face = "modbus-tcp"\nregister_map = "cia402_over_modbus"',
    "modbus-vendor": 'face = "modbus-tcp"\nregister_map = "vendor_style"',
    "modbus-rtu": 'face = "modbus-rtu"\nregister_map = "cia402_over_modbus"',
}
QUICK = "[lost_motion]\nplaces = 12\nruns = 2\nproof_moves = 12\n"
"""For tests of anything but the accuracy."""


def lay_out_axes(
    directory: Path, face: str = "virtual", machine: str = "worn", lost_motion: str = QUICK
) -> tuple[Path, Path]:
    """Write X.toml and Y.toml into a directory; their paths."""
    text = lay_out(directory, machine=machine).read_text(encoding="utf-8")
    paths = (directory / "X.toml", directory / "Y.toml")
    for path, seed in zip(paths, (5, 6), strict=True):
        own = text.replace('name = "X"', f'name = "{path.stem}"').replace("seed = 5", f"seed = {seed}\n{FACES[face]}")
        path.write_text(own + lost_motion, encoding="utf-8")
    return paths


def lay_out_bent(
    directory: Path, face: str = "virtual", *, other: str = "geometric", sections: int = 13
) -> tuple[Path, Path]:
    """X.toml of an axis on a bent way, measured by straightness optics, and Y.toml of the axis that is moved against it at 200 mm.

    other: the simulated machine of Y.
    """
    x, y = lay_out_axes(directory, face, machine="bent", lost_motion="")
    text = x.read_text(encoding="utf-8").replace("sections = 5", f"sections = {sections}").replace("260.0", "480.0")
    optics = "[instrument]\nbeside = { straightness_um = { axis = 2, per_unit = 11.5 } }\n"
    x.write_text(text.replace("[instrument]\n", optics) + STRAIGHTNESS, encoding="utf-8")
    y.write_text(y.read_text(encoding="utf-8").replace('"bent"', f'"{other}"'), encoding="utf-8")
    return x, y


STRAIGHTNESS = """
[straightness]
axis_file = "Y.toml"
at_mm = 200.0
"""
