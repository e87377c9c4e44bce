"""Lost motion by torque: python -m hil.examples.backlash AXIS.toml; the value is printed and not written."""

import sys

import hil.commissioning as hil


def main(path: str) -> int:
    axis = hil.load_drive_axis(path)
    how = axis.backlash or hil.default_backlash(axis.path, axis.limits, axis.scaling, axis.drive.backend)
    with hil.connected_drive(axis) as drive:
        result = hil.measure_backlash(drive, how, hil.backlash_settings(axis, how, drive))
    for one in result.reversals:
        fitted = "nothing" if one.fitted is None else f"{one.fitted.lost_motion_um:.1f} µm"
        print(f"into {one.trace.direction:+d}: {fitted}; by the four-sample rule {one.published_um} µm")
    found = hil.fitted_lost_motion(result.reversals)
    if found is None:
        return 1
    print(f"lost motion {found.mean_um:.1f} ± {found.u95_um:.1f} µm (95 %)")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
