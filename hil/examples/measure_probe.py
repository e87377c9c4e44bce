"""Measure a touch probe's run-out and centre a bore with it: python -m hil.examples.measure_probe MACHINE.toml

Between the two steps the probe is jogged from the block into the bore.
"""

import sys
from datetime import UTC, datetime

import hil.commissioning as hil


def main(path: str) -> int:
    machine = hil.load_probe_machine(path)
    store = hil.RunOutStore(machine.store.directory, machine.name)
    bench = hil.probe_bench(machine) if machine.on_bench else None
    with hil.connected_probe(machine, bench=bench) as session:
        measured, refusal = hil.measure_and_store(session, store, lambda: datetime.now(UTC))
    if refusal is not None:
        print(refusal)
        return 1
    found = measured.run_out
    print(f"run-out {found.size_um:.2f} µm, tip radius {found.tip_radius_mm:.4f} mm, in {measured.seconds:.1f} s")

    if bench is None:
        input("Jog the probe into the bore, then press Enter: ")
    known, _ = store.load()
    bench = None if bench is None else hil.probe_bench(machine, in_bore=True)
    with hil.connected_probe(machine, touching=("x", "y"), bench=bench) as session:
        bore = hil.centre_bore(session, known, hil.CorrectionCode.M93)
    x_mm, y_mm = bore.centring.centre_mm
    print(f"centre of the bore X {x_mm:.4f} mm, Y {y_mm:.4f} mm; the counters end at {bore.correction.counter_mm}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
