"""A maker's Modbus drive with its table and a laser, as a process in real time.

python -m support.maker_process NAME        prints the TCP port and the laser's port as JSON, runs until a signal
"""

from __future__ import annotations

import json
import signal
import sys
import threading
from contextlib import closing

from support.maker_drives import FAMILIES, served

from drivers.clock import WallClock
from sim_backends.clock import SimClock
from sim_backends.laser import SimulatedLaser
from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.parameters import ideal_axis
from sim_backends.serve import Pace


def main(name: str) -> None:
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: ended.set())
    clock = SimClock()
    kind = FAMILIES[name]
    plant = FeedAxis(ideal_axis(), kind.start_counts / kind.counts_per_rev)
    maker = kind(clock, shaft=plant)
    pace, in_turn = Pace(clock, WallClock()), threading.RLock()

    def catch_up() -> bool:
        """A request is answered with the axis as it is when the answer is made, however late this process runs."""
        with in_turn:
            pace.catch_up()
        return not ended.is_set()

    maker.asked = catch_up
    laser = SimulatedLaser(plant, start_ns=clock.now_ns(), wait_for_arrival=False)
    clock.attach(laser.advance, bearable=laser.bearable, settle=laser.settle)
    with closing(laser), served(maker) as port:
        print(
            json.dumps({"tcp": f"127.0.0.1:{port}", "laser": laser.path, "start_counts": kind.start_counts}), flush=True
        )
        while catch_up():
            ended.wait(0.005)
    changed = [address for address, value in maker.found.items() if maker.memory()[address] != value]
    print(
        json.dumps({"powered": maker.servo.powered, "changed": changed, "position_mm": plant.position_mm}), flush=True
    )


if __name__ == "__main__":
    main(sys.argv[1])
