"""Writes the stored tables into the drive's own table, reads them back, and leaves them in force only if the instrument proves them.

python -m hil.examples.drive_table AXIS.toml, with the reading password in HIL_PASSWORD; the axis file names the map of the drive's
table. The zero that it was made in is noted beside the campaigns: `hil params table prove` refuses the drive's table in another one.
"""

import os
import sys

import hil.commissioning as hil


def main(path: str) -> int:
    axis = hil.load_axis(path)
    compensation = hil.SealedStore.of(axis, os.environ["HIL_PASSWORD"]).load()
    targets = hil.iso_targets(axis.measurement.targets_mm[0], axis.measurement.targets_mm[-1], 5, 0.3, seed=1)
    campaign = hil.Campaign.numbered(axis.store.directory, axis.purpose("prove-drive-table"), resume=False)
    with hil.connected(axis) as machine:
        drive = machine.session.drive
        description, wanted = hil.held_table(drive).description, hil.wanted_of(compensation)
        made = hil.drive_table(wanted, description, axis.scaling, axis.limits, bound=axis.correction.bound)
        with hil.changing_table(drive, axis.store.directory / "drive-table-before.json", print) as change:
            change.write(made.raw)
            proof = hil.prove_by_instrument(machine.session, campaign, compensation, targets)
            if proof.good:
                change.switch(True)
            else:
                change.undo()
    if proof.good:  # a drive has no place for the zero that its table was made in
        made_in = compensation.zero or hil.read_zero(axis.zero_path)
        hil.remember_table_zero(hil.zero_note(axis.store.directory, axis.name), made.raw, made_in)
    print(f"{len(made.raw.plus)} points, {made.deviation_um:.2f} µm off the stored tables at most")
    print(proof.verdict)
    return 0 if proof.good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
