"""Pictures of every page of the screen in four states: ready, running, done and lost.

`python tests/study/panel_pictures.py FOLDER [--lang de] [--light] [--size 1024x768] [--state running …] [--page diagnosis …]`
Serves simulated axes, does each page's job, and writes FOLDER/STATE-PAGE.png. Beside each picture it prints what overlaps, is cut or
leaves its card, and which texts have a contrast below 4.5. To be looked at by a person; not a test.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

if __name__ == "__main__":  # the folder of a script is first in the path, and hides this package
    sys.path[0] = str(Path(__file__).parents[1])

from support import panel, probe_files
from support.bench_axis import PASSWORDS, lay_out
from support.campaigns import campaign, wavy
from support.panel import Person
from support.screenshots import DEFECTS, PALE

from hil.records.rows import to_csv

PAGES = ("overview", "axes", "calibrate", "backlash", "lost_motion", "probe", "diagnosis", "parameters", "reports")
STATES = ("ready", "running", "done", "lost")
MORE = """
[lost_motion]
places = 12
runs = 2
proof_moves = 12

[backlash]
reference_plus_mm = 5.0
reference_minus_mm = 5.0
travel_velocity_mm_s = 100.0
parameter = "2201h"
acceleration = "2202h"
parameter_um = 0.01
step_um = 2.0
settle_s = 0.03
readings = 2
velocity_mm_s = 2.0
run_in_mm = 0.2

[uncertainty]
device_um = 0.1
device_um_per_m = 0.5
variation_um = 0.4
"""
QUICK_PROBE = {
    "start_mm": 102.6,
    "search_mm": 1.0,
    "block": "turns = 2",
    "probe": "touch_mm_s = 20.0\nposition_mm_s = 50.0",
    "more": "[bench]\nseed = 4\n",
}
RUNNING_PACE, PROBE_PACE = "3", "0.3"
"""So slow that a job runs while its picture is taken; contacts of a probe are quick."""
Picture = Callable[[Person, str, str], None]


def lay_out_axes(directory: Path) -> list[Path]:
    """Two axes with everything a page asks for; the first with older campaigns, of which the last holds a cyclic error."""
    text = lay_out(
        directory, machine="worn", sections=8, correction="band_um = [-4.0, 4.0]\naccuracy_limit_um = 8.0"
    ).read_text(encoding="utf-8")
    paths = [directory / "X.toml", directory / "Y.toml"]
    for path in paths:
        own = text.replace('name = "X"', f'name = "{path.stem}"').replace("seed = 5", 'seed = 5\nface = "canopen"')
        path.write_text(own + MORE, encoding="utf-8")
    for month in (1, 2, 3, 4):
        here = directory / "X-campaign" / f"verify-{month:03d}"
        here.mkdir(parents=True)
        (here / "campaign.json").write_text(json.dumps({"kind": "verify", "axis": "X"}))
        (here / "finished").touch()
        rows = campaign(lambda c, size=month: size * wavy(c), runs=2, targets=6, scatter=0.0, seed=month)
        if month == 4:
            rows = campaign(lambda c: wavy(c) + 1.2 * np.sin(2 * np.pi * c["target_mm"] / 10.0), targets=14)
        (here / "verify.csv").write_text(f"# begun 2026-0{month}-11T08:00:00+00:00\n{to_csv(rows)}")
    return paths


def lay_out_probe(directory: Path) -> list[Path | str]:
    machine = probe_files.lay_out(directory, **QUICK_PROBE)  # type: ignore[arg-type]
    return [directory / "X.toml", directory / "Y.toml", "--probe", machine]


@contextmanager
def shown(
    person: Person, what: list[Path | str], pace: str, language: str, *, light: bool, builder: bool = True
) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """The address of the first axis's pages, with control of all axes, as builder of the first if asked; and the server."""
    with panel.served(*what, "--pace", pace, "--lang", language) as (address, process):
        for axis in ("Y", "X"):
            person.goes_to(f"{address}axis/{axis}/overview")
            person.clicks("control.take")
            person.waits(lambda: person.finds("control.release").is_displayed(), "this browser holds control")
        if light:
            person.clicks("looks")
        if builder:
            person.becomes_builder(PASSWORDS["HIL_KEY_PASSWORD"], PASSWORDS["HIL_PASSWORD"])
            person.waits(lambda: person.finds("role.become_operator").is_displayed(), "it is the builder's")
        try:
            yield f"{address}axis/X/", process
        finally:
            person.goes_to("about:blank")


def goes_to(person: Person, base: str, page: str) -> None:
    person.goes_to(base + page)
    person.waits(lambda: any(map(str.isdigit, person.reads("chip.X") + "0")), "the page is there")
    live = "return !document.querySelector('[data-live].hil-stale')"
    person.waits(lambda: person.driver.execute_script(live) or person.finds("no-data").is_displayed(), "it is live")
    time.sleep(1.5)  # plots that have just come take their size on


def is_idle(person: Person) -> bool:
    """And known to be."""
    return not {"running", "nodata", "hil-stale", "wait"} & set(
        str(person.finds("chip.X").get_attribute("class")).split()
    )


def is_running(person: Person) -> bool:
    return "running" in str(person.finds("chip.X").get_attribute("class"))


def starts(person: Person, base: str, page: str) -> None:
    """The page's job, as far as it has one."""
    goes_to(person, base, page)
    if page == "diagnosis":
        person.clicks("diagnosis.campaign")
        held = person.driver.find_elements("css selector", ".q-menu .q-item")
        next(one for one in held if "168" in one.text).click()
        person.clicks("diagnosis.start")
        person.waits(lambda: person.reads("diagnosis.status"), "it computes")
        return
    button = {"parameters": "parameters.backup"}.get(page, f"{page}.start")
    person.clicks(button)
    person.agrees()
    person.waits(lambda: is_running(person) or person.reads("header.percent"), "it begins")


def ends(person: Person, page: str) -> None:
    if page == "diagnosis":
        person.waits(lambda: not person.reads("diagnosis.status"), "it is diagnosed")
        time.sleep(2.0)
        return
    time.sleep(2.0)  # until it runs
    over = lambda: person.reads("header.percent") != "" and person.reads("header.left") == "" and is_idle(person)  # noqa: E731
    person.waits(over, "the job is over", 300.0)


def stops(person: Person) -> None:
    person.clicks("stop")
    person.waits(lambda: not is_running(person), "it is stopped")


def ready(person: Person, base: str, pages: list[str], take: Picture, _process: subprocess.Popen[str]) -> None:
    for page in pages:
        goes_to(person, base, page)
        take(person, "ready", page)


def running(person: Person, base: str, pages: list[str], take: Picture, _process: subprocess.Popen[str]) -> None:
    without = [page for page in pages if page in ("overview", "axes", "reports")]
    for page in [one for one in pages if one not in without]:
        starts(person, base, page)
        if page not in ("parameters", "diagnosis"):
            time.sleep(6.0)
        take(person, "running", page)
        if page == "calibrate":
            for other in without:
                goes_to(person, base, other)
                take(person, "running", other)
        if page == "diagnosis":
            ends(person, page)
        elif is_running(person):
            stops(person)


def done(person: Person, base: str, pages: list[str], take: Picture, _process: subprocess.Popen[str]) -> None:
    for page in pages:
        if page not in ("overview", "axes", "reports"):
            starts(person, base, page)
            ends(person, page)
            if page == "calibrate":
                person.clicks("calibrate.verify")
                person.agrees()
                ends(person, page)
            time.sleep(2.0)
        else:
            goes_to(person, base, page)
        take(person, "done", page)


def lost(person: Person, base: str, pages: list[str], take: Picture, process: subprocess.Popen[str]) -> None:
    for page in pages:
        goes_to(person, base, page)
        process.send_signal(signal.SIGSTOP)
        try:
            person.waits(lambda: person.finds("no-data").is_displayed(), "it is marked")
            time.sleep(0.5)
            take(person, "lost", page)
        finally:
            process.send_signal(signal.SIGCONT)
        person.waits(lambda: not person.finds("no-data").is_displayed(), "it is live again")


TAKEN = {"ready": ready, "running": running, "done": done, "lost": lost}


def main() -> None:
    about = argparse.ArgumentParser(description=__doc__)
    about.add_argument("folder", type=Path)
    about.add_argument("--lang", default="en", choices=["en", "de", "zh"])
    about.add_argument("--light", action="store_true")
    about.add_argument("--size", default="1366x768")
    about.add_argument("--state", action="append", choices=STATES)
    about.add_argument("--page", action="append", choices=PAGES)
    how = about.parse_args()
    how.folder.mkdir(parents=True, exist_ok=True)
    width, height = map(int, how.size.split("x"))

    def take(person: Person, state: str, page: str) -> None:
        path = how.folder / f"{state}-{page}.png"
        person.driver.execute_script("window.scrollTo(0, 0)")
        path.write_bytes(person.driver.get_screenshot_as_png())
        print(path, flush=True)
        for script, what in ((DEFECTS, ""), (PALE, "pale: ")):
            for one in dict.fromkeys(person.driver.execute_script(script)):
                print(f"    {what}{one}", flush=True)

    pages = how.page or PAGES
    with panel.browser() as person:
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        person.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        for state in how.state or STATES:
            for of_probe in (False, True):
                pace = "0" if state != "running" else PROBE_PACE if of_probe else RUNNING_PACE
                some = [page for page in pages if (page == "probe") is of_probe]
                with tempfile.TemporaryDirectory() as directory:
                    served = lay_out_probe(Path(directory)) if of_probe else lay_out_axes(Path(directory))
                    if some:
                        with shown(person, list(served), pace, how.lang, light=how.light, builder=not of_probe) as (
                            base,
                            process,
                        ):
                            TAKEN[state](person, base, some, take, process)


if __name__ == "__main__":
    main()
