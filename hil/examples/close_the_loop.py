"""Calibrate, find what the table lacks, add it: python -m hil.examples.close_the_loop AXIS.toml, passwords as in commission.py."""

import sys

import hil


def main(path: str) -> int:
    with hil.open(path) as axis:
        loop = axis.close_loop()
    for finding in loop.raw.turn.diagnosis.findings:
        print(f"{finding.effect} ({finding.action.value}): {finding.explanation}")
    print(f"largest error {loop.before.peak_um:.2f} µm with the table, {loop.after.peak_um:.2f} µm with what was found")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
