"""Lost motion after a reversal: measured, put into force and proven, as by `hil lost-motion`.

python -m hil.examples.lost_motion AXIS.toml, with the passwords in HIL_PASSWORD and HIL_KEY_PASSWORD.
"""

import os
import sys

import hil.commissioning as hil


def main(path: str) -> int:
    axis = hil.load_axis(path)
    how = axis.lost_motion or hil.default_lost_motion(axis.path, axis.limits, axis.measurement.targets_mm)
    store = hil.SealedStore.of(axis, os.environ["HIL_PASSWORD"], os.environ["HIL_KEY_PASSWORD"])
    present = store.stored()
    campaign = hil.Campaign.numbered(axis.store.directory, axis.purpose("lost-motion"), resume=False)
    with hil.connected(axis) as machine:
        machine.session.prepare()
        result = hil.measure_lost_motion(machine.session, campaign, how, present)
        if result.good:
            store.save(result.compensation)
    for one in result.estimate.contenders:
        print(f"{one.fitted.shape.name}: {one.held_out_rms_um:.3f} µm RMS on strokes held out")
    print(f"lost motion {result.estimate.parameters['amount_um']} µm, rising as {result.estimate.rise.shape.name}")
    before, after = abs(result.proof.before_um).max(), abs(result.proof.after_um).max()
    print(f"fresh moves: {before:.2f} µm off at worst before, {after:.2f} µm with the correction in force")
    print(f"stored in {store.path}" if result.good else "not stored: it did not prove itself an improvement")
    return 0 if result.good or result.needless else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
