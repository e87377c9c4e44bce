"""Ctrl-C twice ends the program with its drives told to stop, whatever hangs: each case in a process of its own."""

from __future__ import annotations

import signal
import subprocess
import sys
import time

import pytest

from hil.machine.interrupts import ENDED, INTERRUPTED, STOP_WITHIN_S

pytestmark = pytest.mark.outside

PROGRAM = """
import ctypes, os, signal, sys, threading, time
from hil.machine.interrupts import ending_by_signals
from hil.machine.interrupts import stopped_by_signals

class Drive:
    def send_stop(self):
        os.write(1, b"stop frame\\n")
        {stop}

def hangs():
    {hangs}

with ending_by_signals():
    drive = stopped_by_signals(Drive())
    try:
        os.write(1, b"ready\\n")
        {work}
    finally:
        os.write(1, b"way out\\n")
        {way_out}
"""
SWALLOWS = "while True:\n        try:\n            time.sleep(60)\n        except KeyboardInterrupt:\n            pass"
DEADLOCK = "mutex = ctypes.create_string_buffer(64)\n    lock = ctypes.CDLL(None).pthread_mutex_lock\n    lock(mutex)\n    lock(mutex)"


class Program:
    """The program above, whose signals and lines are counted."""

    def __init__(
        self,
        *,
        hangs: str = "pass",
        stop: str = "pass",
        work: str = "time.sleep(60)",
        way_out: str = "hangs()",
        by: tuple[str, ...] = (),
    ) -> None:
        text = PROGRAM.format(hangs=hangs, stop=stop, work=work, way_out=way_out)
        self.process = subprocess.Popen(
            [*by, sys.executable, "-c", text], stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )
        self.says(b"ready")

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *_exc: object) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()

    def says(self, line: bytes) -> None:
        assert self.process.stdout is not None
        assert self.process.stdout.readline().strip() == line

    def asked(self, number: int = signal.SIGINT) -> None:
        self.process.send_signal(number)

    def ended(self) -> tuple[int, float, bytes]:
        """Exit status, seconds until then, and stderr."""
        began_s = time.monotonic()
        _, errors = self.process.communicate(timeout=60.0)
        return self.process.returncode, time.monotonic() - began_s, errors


@pytest.mark.parametrize("hangs", [SWALLOWS, DEADLOCK], ids=["swallows interrupts", "deadlocked outside Python"])
def test_the_second_signal_stops_the_drives_and_ends_a_way_out_that_hangs(hangs: str) -> None:
    with Program(hangs=hangs) as program:
        program.asked()
        program.says(b"way out")
        program.asked(signal.SIGTERM)
        program.says(b"stop frame")
        status, seconds, errors = program.ended()
        assert (status, errors) == (INTERRUPTED, ENDED)
        assert seconds >= 0.9 * STOP_WITHIN_S, "the way out had its time"


def test_the_third_signal_ends_it_at_once() -> None:
    with Program(hangs=DEADLOCK) as program:
        program.asked()
        program.says(b"way out")
        program.asked()
        program.says(b"stop frame")
        program.asked(signal.SIGHUP)
        status, seconds, errors = program.ended()
        assert (status, errors) == (INTERRUPTED, ENDED)
        assert seconds < 0.9 * STOP_WITHIN_S


def test_work_that_never_hears_the_first_one_is_ended_by_the_second() -> None:
    deaf = "\n            ".join(
        ["while True:", "try:", "    os.write(1, b'hangs\\n'); hangs()", "except KeyboardInterrupt:", "    pass"]
    )
    with Program(hangs=DEADLOCK, work=deaf) as program:
        program.says(b"hangs")
        program.asked()
        program.asked(signal.SIGTERM)
        assert program.ended()[0] == INTERRUPTED


def test_a_drive_that_cannot_be_told_holds_nothing_up() -> None:
    with Program(hangs=DEADLOCK, stop="time.sleep(60)") as program:
        program.asked()
        program.says(b"way out")
        program.asked(signal.SIGTERM)
        assert program.ended()[0] == INTERRUPTED


def test_a_way_out_that_ends_in_time_is_not_cut_off_and_the_second_signal_does_not_disturb_it() -> None:
    with Program(way_out="time.sleep(0.5); os.write(1, b'all put back\\n')") as program:
        program.asked()
        program.says(b"way out")
        program.asked(signal.SIGTERM)
        program.says(b"stop frame")
        program.says(b"all put back")
        status, _, errors = program.ended()
        assert status in (1, -signal.SIGINT)
        assert errors.rstrip().endswith(b"KeyboardInterrupt")
        assert ENDED not in errors


FORGETS = """
        def dawdle():
            for _ in range(20): time.sleep(0.001)
        class Forgets:
            def __del__(self):
                dawdle()
        while True:
            Forgets()
            time.sleep(0.01)"""
LEAKS = """
        class Holds:
            held = 0
            def __enter__(self):
                Holds.held += 1
                for _ in range(20): time.sleep(0.001)
            def __exit__(self, *_):
                for _ in range(20): time.sleep(0.001)
                Holds.held -= 1
        while True:
            with Holds():
                time.sleep(0.01)
            time.sleep(0.01)"""


def test_an_interrupt_in_a_del_is_not_forgotten() -> None:
    with Program(work=FORGETS, way_out="os.write(1, b'all put back\\n')") as program:
        program.asked()
        program.says(b"way out")
        program.says(b"all put back")
        assert b"ignored" not in program.ended()[2]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_what_is_entered_when_a_signal_comes_is_left_again(number: int) -> None:
    with Program(work=LEAKS, way_out="os.write(1, b'held: %d\\n' % Holds.held)") as program:
        time.sleep(0.05)
        program.asked(number)
        program.says(b"way out")
        program.says(b"held: 0")
        assert ENDED not in program.ended()[2]


def test_a_context_manager_that_never_comes_back_is_interrupted_all_the_same() -> None:
    stuck = "\n        class Stuck:\n            def __enter__(self): time.sleep(60)\n        with Stuck(): pass"
    with Program(work=stuck, way_out="os.write(1, b'all put back\\n')") as program:
        program.asked()
        program.says(b"way out")
        program.says(b"all put back")
        assert ENDED not in program.ended()[2]


def test_a_put_off_signal_and_one_more_are_two() -> None:
    with Program(work=LEAKS, way_out="time.sleep(0.5)") as program:
        program.asked()
        program.says(b"way out")
        program.asked(signal.SIGTERM)
        program.says(b"stop frame")
        assert ENDED not in program.ended()[2]


def test_signals_that_another_handler_answers_are_not_counted() -> None:
    own = "import signal; seen = []; before = signal.signal(signal.SIGINT, lambda *_: seen.append(1)); os.write(1, b'own\\n')"
    again = "signal.signal(signal.SIGINT, before); signal.raise_signal(signal.SIGINT)"
    serve = f"{own}\n        while len(seen) < 2: time.sleep(0.01)\n        time.sleep(1.0)\n        {again}"
    with Program(work=serve, way_out="time.sleep(2.5); os.write(1, b'all put back\\n')") as program:
        program.says(b"own")
        program.asked()
        time.sleep(0.2)  # two signals at once are one; in the program, a second later both have been looked at
        program.asked()
        program.says(b"way out")
        program.says(b"all put back")
        assert ENDED not in program.ended()[2]


def test_a_signal_that_the_shell_set_to_be_ignored_stays_so() -> None:
    hangs_up = "signal.raise_signal(signal.SIGHUP); os.write(1, b'goes on\\n'); time.sleep(60)"
    with Program(work=hangs_up, way_out="pass", by=("nohup",)) as program:
        program.says(b"goes on")
        program.asked()
        program.says(b"way out")
        assert ENDED not in program.ended()[2]


LINK = """
import os, signal, threading
from drivers.canopen.bus import CanLink
from drivers.clock import WallClock
from hil.machine.interrupts import ending_by_signals

link, held = CanLink.open(WallClock(), interface="virtual", channel="interrupts"), 0
for i in range(400):
    try:
        with ending_by_signals():
            threading.Timer(0.0005 + 0.000003 * i, os.kill, (os.getpid(), signal.SIGINT)).start()
            while True:
                link.poll() if i % 2 else link.wait(lambda: False, 0.0)
    except KeyboardInterrupt:
        held += link._dispatching._is_owned()
print(held)
"""


def test_no_interrupt_leaves_the_turn_to_dispatch_can_frames_taken() -> None:
    run = subprocess.run([sys.executable, "-c", LINK], capture_output=True, text=True, timeout=60, check=True)
    assert run.stdout == "0\n"
