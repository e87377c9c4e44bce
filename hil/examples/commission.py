"""Commissioning of an axis: python -m hil.examples.commission AXIS.toml, passwords in HIL_PASSWORD and HIL_KEY_PASSWORD."""

import sys

import hil


def main(path: str) -> int:
    with hil.open(path) as axis:
        checked = axis.doctor()
        for check in checked.checks:
            print(f"{check.name}: {check.verdict}, {check.detail}")
        if not checked.good:
            return 1
        calibrated = axis.calibrate()
        proof = axis.verify()
    print(calibrated, proof, *proof.accuracy.explained(), sep="\n")
    return 0 if calibrated.good and proof.good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
