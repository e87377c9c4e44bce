"""Commissioning of an axis: python -m hil.examples.commission AXIS.toml, passwords in HIL_PASSWORD and HIL_KEY_PASSWORD."""

import os
import sys

import hil.commissioning as hil


def main(path: str) -> int:
    axis = hil.load_axis(path)
    store = hil.SealedStore.of(axis, os.environ["HIL_PASSWORD"], os.environ["HIL_KEY_PASSWORD"])
    campaign = hil.Campaign.numbered(axis.store.directory, axis.purpose("commission"), resume=False)
    with hil.connected(axis) as machine:
        for check in hil.doctor(machine.session):
            print(f"{check.name}: {check.verdict}, {check.detail}")
            if not check.good:
                return 1
        machine.session.prepare()
        result = hil.calibrate(machine.session, campaign, axis.correction, store.save_tables)
        proof = hil.verify(machine.session, campaign, band=axis.correction.band)
    found = hil.accuracy_of(axis, proof.records, corrected=True)
    print(f"{found} (A was {hil.iso230(result.before).A:.2f} µm before)")
    print(*found.explained(), f"sealed in {store.path}", sep="\n")
    return 0 if result.inside and proof.good and found.good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
