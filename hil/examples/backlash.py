"""Lost motion by torque: python -m hil.examples.backlash AXIS.toml; the value is printed and not written."""

import sys

import hil


def main(path: str) -> int:
    with hil.open(path) as axis:
        found = axis.backlash()
    for one in found.raw.reversals:
        fitted = "nothing" if one.fitted is None else f"{one.fitted.lost_motion_um:.1f} µm"
        print(f"into {one.trace.direction:+d}: {fitted}; by the four-sample rule {one.published_um} µm")
    if found.lost_motion_um is None or found.u95_um is None:
        return 1
    print(f"lost motion {found.lost_motion_um:.1f} ± {found.u95_um:.1f} µm (95 %)")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
