"""Calibrate, find what the table lacks, add it: python -m hil.examples.close_the_loop AXIS.toml, passwords as in commission.py."""

import os
import sys

import hil.commissioning as hil


def main(path: str) -> int:
    axis = hil.load_axis(path)
    store = hil.SealedStore.of(axis, os.environ["HIL_PASSWORD"], os.environ["HIL_KEY_PASSWORD"])
    campaign = hil.Campaign.numbered(axis.store.directory, axis.purpose("close-loop"), resume=False)
    with hil.connected(axis) as machine:
        machine.session.prepare()
        turn = hil.close_loop(machine.session, campaign, axis.correction, store.save).turn
    for finding in turn.diagnosis.findings:
        print(f"{finding.effect} ({finding.action.value}): {finding.explanation}")
    before, after = (abs(rows.error_um).max() for rows in (turn.before, turn.after))
    print(f"largest error {before:.2f} µm with the table, {after:.2f} µm with what was found")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
