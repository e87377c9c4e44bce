#!/usr/bin/python3
"""Runs inside LinuxCNC as its DISPLAY, in the system's Python: homes the joint, goes to the positions of moves.json one after the
other, and writes for each what the joint adds to its command once it has settled, as halcmd prints it, to readings.json.
"""

import collections
import json
import subprocess
import time
from pathlib import Path

import linuxcnc

DEADLINE_S = 60.0
THERE_MM = 5e-7  # half of the commanded text's last digit
SETTLED_MM = 2e-9
SETTLED_READINGS = 12  # some ten servo cycles apart in all


def added_mm():
    """joint.0.motor-pos-cmd - joint.0.pos-cmd, formed by a HAL component within one servo cycle."""
    answer = subprocess.run(["halcmd", "getp", "sum2.0.out"], capture_output=True, text=True, check=True)
    return float(answer.stdout)


def until(condition, what):
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        if time.monotonic() > deadline:
            raise SystemExit(f"not within {DEADLINE_S:g} s: {what}")
        time.sleep(0.002)


def main():
    command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()

    def complete():
        result = command.wait_complete(DEADLINE_S)
        message = errors.poll()
        if result != linuxcnc.RCS_DONE or message:
            raise SystemExit(f"LinuxCNC answered {result} {message}")

    def polled(name):
        status.poll()
        return getattr(status, name)

    for step, argument in (
        ("state", linuxcnc.STATE_ESTOP_RESET),
        ("state", linuxcnc.STATE_ON),
        ("mode", linuxcnc.MODE_MANUAL),
    ):
        getattr(command, step)(argument)
        complete()
    command.home(0)
    complete()
    until(lambda: polled("homed")[0], "homed")
    command.mode(linuxcnc.MODE_MDI)
    complete()
    readings = []
    for position_mm in json.loads(Path("moves.json").read_text()):
        command.mdi(f"G53 G0 X{position_mm:.6f}")
        complete()
        until(lambda: polled("inpos"), "in position")

        def there(target_mm=position_mm):  # "in position" may be told early
            return abs(polled("joint")[0]["output"] - target_mm) < THERE_MM

        until(there, "at the position")
        seen = collections.deque([added_mm()], maxlen=SETTLED_READINGS)

        def settled(seen=seen):
            seen.append(added_mm())
            return len(seen) == SETTLED_READINGS and max(seen) - min(seen) <= SETTLED_MM

        until(settled, "correction settled")
        status.poll()
        readings.append({"position_mm": status.joint[0]["output"], "added_mm": seen[-1]})
    Path("readings.json").write_text(json.dumps(readings))


if __name__ == "__main__":
    main()
