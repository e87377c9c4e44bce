"""Lost motion after a reversal: measured, put into force and proven, as by `hil lost-motion`.

python -m hil.examples.lost_motion AXIS.toml, with the passwords in HIL_PASSWORD and HIL_KEY_PASSWORD.
"""

import sys

import hil


def main(path: str) -> int:
    with hil.open(path) as axis:
        found = axis.lost_motion()
    for one in found.raw.estimate.contenders:
        print(f"{one.fitted.shape.name}: {one.held_out_rms_um:.3f} µm RMS on strokes held out")
    print(f"lost motion {found.amount_um:.2f} µm, rising as {found.shape}")
    print(
        f"fresh moves: {found.before_um:.2f} µm off at worst before, {found.after_um:.2f} µm with the correction in force"
    )
    print(f"stored in {axis.file.tables_path}" if found.stored else "not stored: it is not proven to be an improvement")
    return 0 if found.good else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
