"""Writes the stored tables into the drive's own table, reads them back, and leaves them in force only if the instrument proves them.

python -m hil.examples.drive_table AXIS.toml, with the reading password in HIL_PASSWORD; the axis file names the map of the drive's
table. The zero that it was made in is noted beside the campaigns: `hil params table prove` refuses the drive's table in another one.
"""

import os
import sys

from hil.axis.axis_file import iso_targets, load_axis
from hil.correction.store import SealedStore
from hil.drive_table import drive_table, wanted_of
from hil.drive_table.change import changing, held_table, remember_zero, zero_note
from hil.drive_table.proof import prove_by_instrument
from hil.machine.wiring import connected
from hil.records.journal import Campaign
from hil.records.zero import read_zero


def main(path: str) -> int:
    axis = load_axis(path)
    compensation = SealedStore.of(axis, os.environ["HIL_PASSWORD"]).load()
    targets = iso_targets(axis.measurement.targets_mm[0], axis.measurement.targets_mm[-1], 5, 0.3, seed=1)
    campaign = Campaign.numbered(axis.store.directory, axis.purpose("prove-drive-table"), resume=False)
    with connected(axis) as machine:
        drive = machine.session.drive
        description, wanted = held_table(drive).description, wanted_of(compensation)
        made = drive_table(wanted, description, axis.scaling, axis.limits, bound=axis.correction.bound)
        with changing(drive, axis.store.directory / "drive-table-before.json", print) as change:
            change.write(made.raw)
            proof = prove_by_instrument(machine.session, campaign, compensation, targets)
            if proof.good:
                change.switch(True)
            else:
                change.undo()
    if proof.good:  # a drive has no place for the zero that its table was made in
        made_in = compensation.zero or read_zero(axis.zero_path)
        remember_zero(zero_note(axis.store.directory, axis.name), made.raw, made_in)
    print(f"{len(made.raw.plus)} points, {made.deviation_um:.2f} µm off the stored tables at most")
    print(proof.verdict)
    return 0 if proof.good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
