"""Lost motion by torque: python -m hil.examples.backlash AXIS.toml; the value is printed and not written."""

import sys

from hil.axis import load_drive_axis
from hil.axis_backlash import default_backlash
from hil.backlash_settings import backlash_settings
from hil.procedures.torque_backlash import measure_backlash
from hil.wind_up.result import NAMES, fitted_lost_motion
from hil.wiring import connected_drive


def main(path: str) -> int:
    axis = load_drive_axis(path)
    how = axis.backlash or default_backlash(axis.path, axis.limits, axis.scaling, axis.drive.backend)
    with connected_drive(axis) as drive:
        result = measure_backlash(drive, how, backlash_settings(axis, how, drive))
    for one in result.reversals:
        fitted = "nothing" if one.fitted is None else f"{one.fitted.lost_motion_um:.1f} µm"
        print(f"{NAMES[one.trace.direction]}: {fitted}; by the four-sample rule {one.published_um} µm")
    found = fitted_lost_motion(result.reversals)
    if found is None:
        return 1
    print(f"lost motion {found.mean_um:.1f} ± {found.u95_um:.1f} µm")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
