"""Creep after a stop: python -m hil.examples.creep AXIS.toml OUT.csv; `hil diagnose OUT.csv` reads the rows."""

import sys

import hil


def main(path: str, out: str) -> int:
    with hil.open(path) as axis:
        axis.home()
        runs = []
        for run, place_mm in enumerate((100.0, 20.0, 100.0, 20.0, 100.0), start=1):
            axis.move_to(place_mm)
            runs.append(hil.Rows.of(axis.watch(20.0, every_s=0.5), run))
    rows = sum(runs[1:], runs[0])
    print(rows, "in", rows.save(out))
    for one in runs:
        crept_um = 1000.0 * (one["measured_mm"][-1] - one["measured_mm"][0])
        print(f"{one['target_mm'][0]:g} mm: {crept_um:+.2f} µm in 20 s")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
