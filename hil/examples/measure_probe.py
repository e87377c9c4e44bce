"""Measure a touch probe's run-out and centre a bore with it: python -m hil.examples.measure_probe MACHINE.toml

Between the two steps the probe is jogged from the block into the bore.
"""

import sys
from datetime import UTC, datetime

from hil.probe.machine_file import load_probe_machine
from hil.probe.procedure import centre_bore, measure_and_store
from hil.probe.runout import CorrectionCode
from hil.probe.store import RunOutStore
from hil.probe.wiring import connected_probe, probe_bench


def main(path: str) -> int:
    machine = load_probe_machine(path)
    store = RunOutStore(machine.store.directory, machine.name)
    bench = probe_bench(machine) if machine.on_bench else None
    with connected_probe(machine, bench=bench) as session:
        measured, refusal = measure_and_store(session, store, lambda: datetime.now(UTC))
    if refusal is not None:
        print(refusal)
        return 1
    found = measured.run_out
    print(f"run-out {found.size_um:.2f} µm, tip radius {found.tip_radius_mm:.4f} mm, in {measured.seconds:.1f} s")

    if bench is None:
        input("Jog the probe into the bore, then press Enter: ")
    known, _ = store.load()
    bench = None if bench is None else probe_bench(machine, in_bore=True)
    with connected_probe(machine, touching=("x", "y"), bench=bench) as session:
        bore = centre_bore(session, known, CorrectionCode.M93)
    x_mm, y_mm = bore.centring.centre_mm
    print(f"centre of the bore X {x_mm:.4f} mm, Y {y_mm:.4f} mm; the counters end at {bore.correction.counter_mm}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
