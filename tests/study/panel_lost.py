"""Time from the loss of server, drive or instrument to its mark on the screen.

`python tests/study/panel_lost.py [MOMENTS [SOURCE …]]`, sources: server, drive, instrument (default all).
Each is killed at MOMENTS moments (default 20), while the axis stands and while a measurement of lost motion runs, by turns; every
fourth time it is frozen instead. Every time a headless Chromium shows the axis, and every time all is started anew; the time is by the
browser's clock and this process's, which is the same. Prints each, and at the end the median and the worst of each source.
"""

from __future__ import annotations

import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

if __name__ == "__main__":  # the folder of a script is first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from support import panel
from support.machine import machine
from support.panel import WATCH, Person

CARDS = {"server": "overview.drive", "drive": "overview.drive", "instrument": "overview.instrument"}
LONGEST_S = 6.0
"""Latest moment of a loss after everything is live, s."""


def lost_after_s(person: Person, source: str, moment_s: float, how: signal.Signals, *, runs: bool) -> float:
    """One loss, and the time until its card is marked, s."""
    card = CARDS[source]
    with (
        tempfile.TemporaryDirectory() as directory,
        machine(Path(directory)) as axis,
        panel.served(axis.axis_file) as (address, server),
    ):
        person.goes_to(f"{address}axis/X/lost_motion")
        if runs:
            person.clicks("control.take")
            person.clicks("lost_motion.start")
            person.agrees()
        person.goes_to(f"{address}axis/X/overview")
        stale = lambda: "hil-stale" in str(person.finds(card).get_attribute("class"))  # noqa: E731
        person.waits(lambda: not stale(), "it is live")
        person.driver.execute_script(WATCH)
        time.sleep(moment_s)
        victims: dict[str, subprocess.Popen[str]] = {
            "server": server,
            "drive": axis.drive,
            "instrument": axis.laser,
        }
        person.waits(lambda: not stale(), "it is live")  # a machine that is too busy may have missed a beat
        person.driver.execute_script("window.hilFirstGone = {}")
        begun_s = time.time()
        victims[source].send_signal(how)
        person.waits(stale, "it is marked")
        at_ms = person.driver.execute_script("return window.hilFirstGone[arguments[0]]", card)
        if how is signal.SIGSTOP:
            victims[source].send_signal(signal.SIGCONT)
        person.goes_to("about:blank")
        if source == "server":
            server.kill()
            server.wait(panel.PATIENCE_S)
    return float(at_ms) / 1000.0 - begun_s


def main(moments: int = 20, *sources: str) -> None:
    random_moments = random.Random(18)
    with panel.browser() as person:
        for source in sources or CARDS:
            found = []
            for number in range(moments):
                how = signal.SIGSTOP if number % 4 == 3 else signal.SIGKILL
                moment_s, runs = random_moments.uniform(0.0, LONGEST_S), number % 2 == 1
                found.append(lost_after_s(person, source, moment_s, how, runs=runs))
                what = f"{source}, {how.name}, {moment_s:.2f} s, {'a job runs' if runs else 'it stands'}"
                print(f"{what}: marked after {found[-1]:.3f} s", flush=True)
            print(
                f"{source}: median {statistics.median(found):.3f} s, worst {max(found):.3f} s of {moments}", flush=True
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20, *sys.argv[2:])
