"""Measure a touch probe's run-out and centre a bore with it: python -m hil.examples.measure_probe MACHINE.toml

Between the two steps the probe is jogged from the block into the bore.
"""

import sys

import hil


def main(path: str) -> int:
    probe = hil.open_probe(path)
    found = probe.measure()
    print(found.sentence)
    if not found.good:
        return 1
    if not probe.file.on_bench:
        input("Jog the probe into the bore, then press Enter: ")
    print(probe.centre().sentence)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
