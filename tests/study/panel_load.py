"""Load of the screen with many axes: `python tests/study/panel_load.py [AXES [MINUTES]]` (default 8 axes, 2 minutes).

Every axis is a simulated drive with a laser in a process of its own (`hil sim modbus`), read over Modbus TCP and a terminal, so that
the server's own share of a processor and its memory are separate from the simulation's. A headless Chromium shows them all. The axes
are at rest, which costs as much as motion. Prints a line every ten seconds, and the measured figures at the end.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

if __name__ == "__main__":  # the folder of a script is first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from support import panel

EVERY_S, SETTLED_S = 10.0, 20.0
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Use:
    """Processor time and memory of a process at a moment."""

    at_s: float
    cpu_s: float
    resident_mb: float

    @classmethod
    def of(cls, pid: int) -> Use:
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        kb = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text(encoding="ascii"))
        resident_mb = int(kb[1]) / 1024.0 if kb else 0.0
        return cls(time.monotonic(), (int(fields[11]) + int(fields[12])) / _TICKS, resident_mb)

    def share_since(self, before: Use) -> float:
        """Share of one processor since an earlier moment."""
        return (self.cpu_s - before.cpu_s) / (self.at_s - before.at_s)


@contextmanager
def simulated(directory: Path, number: int) -> Iterator[tuple[Path, int]]:
    """One machine with its laser; its axis file, and its process."""
    path = directory / f"X{number}.toml"
    command = [
        sys.executable,
        "-m",
        "hil.app",
        "sim",
        "modbus",
        "--tcp",
        "127.0.0.1:0",
        "--laser",
        "--axis-file",
        str(path),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            json.loads(process.stdout.readline())
            yield path, process.pid
        finally:
            process.send_signal(signal.SIGINT)


def main(axes: int = 8, minutes: float = 2.0) -> None:
    with ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        machines = [stack.enter_context(simulated(directory, number)) for number in range(1, axes + 1)]
        address, server = stack.enter_context(panel.served(*(path for path, _ in machines)))
        person = stack.enter_context(panel.browser())
        person.goes_to(f"{address}axis/X1/axes")
        for number in range(1, axes + 1):
            person.waits_for_a_figure(f"axes.X{number}.position")
        time.sleep(SETTLED_S)
        _watch(server.pid, [pid for _, pid in machines], 60.0 * minutes, person)


def _watch(server: int, machines: list[int], seconds: float, person: panel.Person) -> None:
    begin, simulation = Use.of(server), [Use.of(pid) for pid in machines]
    uses = [begin]
    while uses[-1].at_s - begin.at_s < seconds:
        time.sleep(EVERY_S)
        uses.append(Use.of(server))
        last = uses[-1]
        print(
            f"{last.at_s - begin.at_s:6.0f} s: {100 * last.share_since(uses[-2]):5.1f} %, {last.resident_mb:6.1f} MB,"
            f" {_shown(person)} plots live",
            flush=True,
        )
    end = uses[-1]
    shares = [Use.of(pid).share_since(before) for pid, before in zip(machines, simulation, strict=True)]
    rates_hz = _rates_hz(person)
    print(
        f"server: {100 * end.share_since(begin):.1f} % of a processor, {begin.resident_mb:.1f} -> {end.resident_mb:.1f} MB"
    )
    print(
        f"shown: {min(rates_hz):.1f} to {max(rates_hz):.1f} looks a second of {len(rates_hz)} axes, over the last minute"
    )
    print(f"simulation: {100 * sum(shares):.0f} % of a processor, in its own processes")


def _shown(person: panel.Person) -> int:
    """Number of plots in the browser that have got points since the last call."""
    script = """
        const ends = [...hilLives.values()].map((live) => live.last);
        const before = window.hilEnds ?? [];
        window.hilEnds = ends;
        return ends.filter((end, index) => end !== before[index]).length;
    """
    return int(person.driver.execute_script(script))


def _rates_hz(person: panel.Person) -> list[float]:
    """Rates of the points that each plot in the browser shows, Hz, by their own times."""
    script = """
        return [...hilLives.values()].map(({ rows }) => (rows.length - 1) / (rows.at(-1)[0] - rows[0][0]));
    """
    return [float(rate) for rate in person.driver.execute_script(script)]


if __name__ == "__main__":
    main(*(int(text) if index == 0 else float(text) for index, text in enumerate(sys.argv[1:])))  # type: ignore[arg-type]
