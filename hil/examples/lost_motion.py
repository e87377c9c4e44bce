"""What is lost after a reversal, and over which travel, by the instrument: python -m hil.examples.lost_motion AXIS.toml."""

import sys

import numpy as np

import hil.commissioning as hil

STROKE_MM, STEPS, STROKES = 4.0, 24, 6


def main(path: str) -> int:
    axis = hil.load_axis(path)
    campaign = hil.Campaign.numbered(axis.store.directory, axis.purpose("lost-motion"), resume=False)
    travels = np.round(np.geomspace(0.01, STROKE_MM, STEPS), 4)  # fine where the motion comes back
    low = float(np.mean(axis.measurement.targets_mm)) - STROKE_MM / 2
    steps = [
        hil.Step(run, 1, low + travel, float(travel))
        if run % 2
        else hil.Step(run, -1, low + STROKE_MM - travel, float(travel))
        for run in range(1, STROKES + 1)
        for travel in travels.tolist()
    ]
    with hil.connected(axis) as machine:
        machine.session.prepare()
        records = hil.measure(machine.session, campaign, "reversals", steps)
    reversals = []
    for run in range(2, STROKES + 1):  # the first has no whole stroke before it
        before, rows = records.where(records.run == run - 1), records.where(records.run == run)
        travel = np.concatenate([[0.0], rows["since_reversal_mm"]])
        error = np.concatenate([before.error_um[-1:], rows.error_um])  # the turning point ends the stroke before
        reversals.append(hil.MeasuredReversal(int(rows.direction[0]), travel, error, STROKE_MM))
    for found in hil.compete_lost_motion(reversals, block_mm=0.02):
        shape = found.fitted.rise
        amounts = " + ".join(f"{amount:.2f}" for amount in shape.amounts_um)
        lengths = ", ".join(f"{length:.2f}" for length in shape.lengths_mm)
        print(
            f"{shape.shape.name}: {amounts} µm over {lengths} mm, {found.held_out_rms_um:.2f} µm RMS on strokes held out"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
