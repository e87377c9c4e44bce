"""Writes the stored tables into the drive's own table, reads them back, and leaves them in force only if the instrument proves them.

python -m hil.examples.drive_table AXIS.toml, with the reading password in HIL_PASSWORD; the axis file names the map of the drive's
table. The zero that it was made in is noted beside the campaigns: `hil params table prove` refuses the drive's table in another one.
"""

import sys

import hil


def main(path: str) -> int:
    with hil.open(path) as axis:
        found = axis.drive_table.download(positions=5)
    if found.made is not None:
        print(f"{len(found.made.raw.plus)} points, {found.deviation_um:.2f} µm off the stored tables at most")
    print(found.sentence)
    return 0 if found.good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
