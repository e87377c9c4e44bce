"""A day of streaming in simulated time, with corrections, random faults and reconnects: memory, samples and set-points accounted for.

    python tests/study/endurance.py                     24 h in shifts of an hour, about 20 minutes
    python tests/study/endurance.py --hours 1 --seed 2

An axis moves to and fro in a stream of 20 set-points a second, each corrected by tables, lost motion and two effects.
Faults come about every three minutes, of kinds that a stream survives and kinds that end it; then the drive is connected
anew, its fault is reset, and the stream goes on. Each hour has a new simulated drive and wire, in the same process. What
is accounted for, by a listener of its own on the wire:

    samples        each cycle gave a fresh sample, one stated to be late, or an error; a frame of feedback beyond one a
                   cycle belongs to a cycle that was late or ended with an error
    set-points     the place in each set-point on the wire is the command; for the rows of the journal (one a second, on
                   disk) also that of the row read back; every row that was written is in the file afterwards
    memory         resident, at the end of each hour
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import cos, pi, sin
from pathlib import Path

import numpy as np

if not __package__:
    sys.path[0] = str(Path(__file__).resolve().parents[1])  # its own place would hide the package

from support.can_bench import CanBench
from support.can_bus_model import frame_bits
from support.can_wire import SimWire

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.stream import CyclicStream
from drivers.cia402.power import PowerTimes
from drivers.errors import BridgeError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from hil.correction.compensation import Compensation, MotionHistory
from hil.correction.rise import TWO_TANH, Rise
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.effects import ALL, Form, NonLinear, Term
from hil.effects.warming import TEMPERATURE
from hil.machine.set_points import CommandState
from hil.records.journal import Campaign
from hil.records.rows import read_csv
from sim_backends.bare_shaft import SMALL_SERVO
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind

NODE, PERIOD_S, HOUR_S = 5, 0.05, 3600.0
COUNTS_PER_MM = 10_000
SCALING = AxisScaling(100_000, 10.0)
LIMITS = DriveLimits(-10.0, 120.0, 200.0, 2000.0)
SETTINGS = CanOpenSettings(sdo_timeout_s=0.1, heartbeat_s=0.05, guard_s=0.2, power=PowerTimes(fault_reset_s=0.5))
COLUMNS = ("run", "direction", "target_mm", "command_mm", "measured_mm", "time_s")
JOURNALED_EVERY = 20
FAULTS_EVERY_S = 180.0
K = CanFaultKind
SURVIVED = (
    (K.TPDO_LOST, 0.0, 1),
    (K.TPDO_LATE, 0.045, 1),
    (K.SYNC_LOST, 0.0, 1),
    (K.RPDO_LOST, 0.0, 1),
    (K.EMCY_BURST, 20.0, 0),
)
ENDING = (
    (K.TPDO_LOST, 1.0),
    (K.NODE_DEAD, 1.0),
    (K.REBOOT, 0.0),
    (K.POWER_CUT, 0.8),
    (K.NMT_PRE_OPERATIONAL, 0.0),
    (K.HEARTBEAT_STOPS, 1.0),
    (K.DRIVE_FAULT, 0.0),
    (K.SAFE_TORQUE_OFF, 1.0),
    (K.FOREIGN_CONTROLWORD, 0.0),
)


def correction() -> Compensation:
    """Tables of 200 places, lost motion of two tanh terms, a cyclic error and a thermal expansion."""
    nodes = np.linspace(-10.0, 120.0, 200)
    pitch_um = 6.0 * np.sin(nodes / 20.0)
    by_id = {effect.id: effect for effect in ALL}
    period = NonLinear("period_mm", 1.0, 250.0)
    nothing = ((0.0,) * 3,) * 3
    cyclic = Term(
        by_id["cyclic"], Form("cyclic", "fundamental", ("target_mm",), {}, (period,)), (10.0,), (1.2, 0.5), nothing
    )
    warm = Form("thermal_expansion", TEMPERATURE, ("temp_screw_c", "target_mm"))
    growth = Term(by_id["thermal_expansion"], warm, (), (11.0,), ((0.0,),))
    tables = TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(nodes, pitch_um, pitch_um - 8.0))
    return Compensation(tables, (cyclic, growth), Rise(TWO_TANH, (5.0, 3.0), (0.2, 1.0, 0.5)))


def path_mm(time_s: float) -> float:
    """To and fro between 5 and 95 mm within 40 s."""
    return 50.0 - 45.0 * cos(2.0 * pi * time_s / 40.0)


class Listener:
    """A listener on the wire: the last set-point before each SYNC, and the frames of feedback after it."""

    def __init__(self, wire: SimWire) -> None:
        self.set_point_counts = 0
        self.set_points = self.feedback = self.syncs = 0
        wire.add_node().connect(self._on_frame, lambda _now_ns: None, lambda: None)

    def _on_frame(self, cob_id: int, data: bytes, _now_ns: int) -> None:
        if cob_id == 0x200 + NODE:
            self.set_point_counts = int.from_bytes(data[:4], "little", signed=True)
            self.set_points += 1
        elif cob_id == 0x180 + NODE:
            self.feedback += 1
        elif cob_id == 0x080:
            self.syncs += 1


@dataclass
class Account:
    """What happened. cycles = fresh + late + ended; unlike: set-points on the wire that were not the command."""

    cycles: int = 0
    fresh: int = 0
    late: int = 0
    ended: int = 0
    spare_feedback: int = 0
    missing_feedback: int = 0
    unlike: int = 0
    journaled: int = 0
    read_back: int = 0
    rows_unlike: int = 0
    faults: int = 0
    reconnects: int = 0
    memory_mb: list[float] = field(default_factory=list)
    endings: Counter[str] = field(default_factory=Counter)

    @property
    def good(self) -> bool:
        """Whether everything is accounted for; memory is judged apart."""
        return (
            self.cycles == self.fresh + self.late + self.ended
            and not self.unlike
            and not self.missing_feedback
            and self.spare_feedback <= self.late + self.ended
            and self.journaled == self.read_back
            and not self.rows_unlike
        )

    def growth_mb_per_h(self) -> float:
        """Slope of the memory over the hours after the first, least squares; 0 of fewer than three."""
        late = self.memory_mb[1:]
        return float(np.polyfit(np.arange(len(late)), late, 1)[0]) if len(late) >= 3 else 0.0


def drawn_faults(rng: random.Random, seconds: float) -> list[CanFault]:
    """Faults of an hour, in random order and at random times, none within the last 10 s."""
    found, at_s = [], 5.0
    while True:
        at_s += rng.uniform(0.2, 1.8) * FAULTS_EVERY_S
        if at_s > seconds - 10.0:
            return found
        if rng.random() < 0.5:
            kind, size, count = rng.choice(SURVIVED)
            found.append(CanFault(kind, at_s, 0.5 if count else 0.0, size, count))
        else:
            kind, duration_s = rng.choice(ENDING)
            size = {K.DRIVE_FAULT: 0x3210, K.FOREIGN_CONTROLWORD: 0.0}.get(kind, 0.0)
            found.append(CanFault(kind, at_s, duration_s, size))


class Shift:
    """One hour on one simulated drive."""

    def __init__(self, account: Account, campaign: Campaign, number: int, rng: random.Random, seconds: float) -> None:
        self.account, self.campaign, self.number, self.seconds = account, campaign, number, seconds
        faults = drawn_faults(rng, seconds)
        account.faults += len(faults)
        parameters = replace(SMALL_SERVO, feed_forward=1.0)
        self.bench = CanBench((NODE,), 1_000_000, {NODE: faults}, servo_parameters=parameters)
        self.clock = self.bench.clock
        self.listener = Listener(self.bench.wire)
        self.state = CommandState()
        self.state.compensation = correction()
        self.on_wire: list[int] = []  # counts on the wire at each row of the journal

    def run(self) -> None:
        """Stream until the hour is over; after each error connect anew."""
        name = f"hour-{self.number:02d}"
        with self.campaign.rows(name, COLUMNS) as journal:
            self.journal = journal
            while self.clock.now_ns() < self.seconds * 1e9:
                try:
                    self._connected()
                except BridgeError as error:
                    self.account.endings[type(error).__name__] += 1
                    self.account.reconnects += 1
                    self.clock.sleep_s(1.0)
        rows = read_csv(self.campaign.directory / f"{name}.csv")
        self.account.read_back += len(rows)
        counts = np.round(rows.command_mm * COUNTS_PER_MM).astype(int)
        self.account.rows_unlike += int(np.sum(counts != np.array(self.on_wire)))

    def _connected(self) -> None:
        with CanLink(self.bench.port(), self.clock) as link:
            drive = CanOpenDrive("X", SCALING, LIMITS, self.clock, link=link, node_id=NODE, settings=SETTINGS)
            with drive:
                drive.reset_fault()
                drive.enable()
                start_mm = path_mm(self.clock.now_ns() * 1e-9)
                drive.start_move(start_mm, 50.0)
                drive.wait_for(lambda sample: sample.target_reached, 10.0, "arrive")
                direction = 1 if path_mm(self.clock.now_ns() * 1e-9) >= start_mm else -1
                self.state.set_position(MotionHistory(start_mm, direction), start_mm)
                self._stream(drive, start_mm)

    def _stream(self, drive: CanOpenDrive, from_mm: float) -> None:
        """Follow the path, from where the axis stands; it is reached by and by, as the path went on meanwhile."""
        account, state, listener = self.account, self.state, self.listener
        behind_mm = from_mm - path_mm(self.clock.now_ns() * 1e-9)
        known = {
            "temp_screw_c": 22.0 + 3.0 * sin(self.clock.now_ns() * 1e-9 / 2000.0),
            "time_s": 0.0,
            "velocity_mm_s": 7.0,
        }
        points = state.stream(known)
        with CyclicStream([drive], SetPointSettings(PERIOD_S, following_error_mm=5.0)) as stream:
            while (now_s := self.clock.now_ns() * 1e-9) < self.seconds:
                behind_mm *= 0.98
                target_mm = path_mm(now_s + PERIOD_S) + behind_mm
                known["time_s"] = now_s
                command_mm = points.command_mm(target_mm)
                before, late_before = listener.feedback, stream.late_feedback
                account.cycles += 1
                try:
                    stream.cycle([command_mm])
                except BaseException:
                    account.ended += 1
                    account.spare_feedback += listener.feedback - before
                    raise
                points.issued()
                came = listener.feedback - before
                late = stream.late_feedback > late_before
                account.late += late
                account.fresh += not late
                account.spare_feedback += came if late else max(0, came - 1)
                account.missing_feedback += not late and came == 0
                account.unlike += listener.set_point_counts != round(command_mm * COUNTS_PER_MM)
                if stream.cycles % JOURNALED_EVERY == 0:
                    self._journal(target_mm, command_mm, stream.found[0][1], now_s)

    def _journal(self, target_mm: float, command_mm: float, measured_mm: float, time_s: float) -> None:
        history = self.state.known_history
        values = (self.number, history.direction, target_mm, command_mm, measured_mm, time_s)
        self.journal.append(dict(zip(COLUMNS, values, strict=True)))
        self.on_wire.append(self.listener.set_point_counts)
        self.account.journaled += 1


def resident_mb() -> float:
    """Resident memory of this process, MB."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def run(hours: float, seed: int, folder: Path, shift_s: float = HOUR_S) -> Account:
    """Stream so many hours, in shifts; rows are kept below `folder`."""
    rng, account = random.Random(seed), Account()
    campaign = Campaign(folder / "endurance", {"kind": "endurance", "axis": "X", "seed": seed}, resume=False)
    began = time.monotonic()
    for number in range(max(1, round(hours * HOUR_S / shift_s))):
        Shift(account, campaign, number, rng, shift_s).run()
        frame_bits.cache_clear()  # the simulated wire's own, of up to 65536 frames, is no growth
        account.memory_mb.append(resident_mb())
        print(
            f"shift {number + 1:2}: {account.cycles:,} cycles, {account.faults} faults, {account.reconnects} reconnects,"
            f" {account.memory_mb[-1]:.1f} MB, {time.monotonic() - began:.0f} s",
            flush=True,
        )
    return account


def main(words: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="hil-endurance-") as place:
        account = run(args.hours, args.seed, Path(place), shift_s=min(HOUR_S, args.hours * HOUR_S))
    print(f"{args.hours:g} h: {account}")
    print(f"memory grows by {account.growth_mb_per_h():+.2f} MB an hour after the first")
    print("everything is accounted for" if account.good else "NOT EVERYTHING IS ACCOUNTED FOR")
    return 0 if account.good else 1


if __name__ == "__main__":
    raise SystemExit(main())
