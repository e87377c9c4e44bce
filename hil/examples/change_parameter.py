"""Change one parameter of the drive and prove it: python -m hil.examples.change_parameter X.toml 6072h 900."""

import sys

import hil


def main(path: str, address: str, value: str) -> int:
    with hil.open(path) as axis:
        before = axis.parameters.backup()
        written = axis.parameters.download({address: int(value)})
        proof = axis.parameters.verify({address: int(value)})
    print(written, proof, f"the drive as it was: {before}", sep="\n")
    return 0 if proof.good else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
