"""Every verb that moves an axis, on the smallest possible bench: used by the hostile suite, the stop table and the kills.

A verb is a function of a `Place`; it connects, works and disconnects, as the command of that name does, and raises what it raises.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from hostile.can_peer import CanPeer, stand_in
from support import probe_files
from support.bench_axis import AXIS, PASSWORDS
from support.probe_files import connected_probe

import hil.machine.bench_canopen
import hil.machine.bench_wiring
import hil.probe.wiring
from drivers.clock import Waiting
from drivers.errors import BridgeError, UnprovenError
from hil.axis.axis_file import AxisConfig, load_axis
from hil.backlash.procedure import measure_backlash
from hil.backlash.settings import backlash_settings
from hil.calibration.explore import Exploration
from hil.calibration.job import run_calibration, run_straightness, run_verification
from hil.correction.compensation import Compensation
from hil.correction.sealed import Cost, new_key, save_private_key, save_public_key
from hil.correction.store import SealedStore
from hil.correction.tables import DirectionalTable, TableMode, TableSet
from hil.diagnosis.loop.job import run_loop
from hil.diagnosis.loop.procedure import Turning
from hil.doctor.procedure import doctor
from hil.drive_table.change import held_table
from hil.drive_table.proof import prove_by_instrument
from hil.drive_table.quantise import drive_table, wanted_of
from hil.effects import ALL
from hil.lost_motion.circle.figures import Circle
from hil.lost_motion.circle.procedure import drive_circle, prepare
from hil.lost_motion.job import run_lost_motion
from hil.machine.axes_wiring import connected_across, connected_axes
from hil.machine.bench_wiring import RunningBench, running_bench
from hil.machine.wiring import connected, connected_drive
from hil.probe.machine_file import load_probe_machine
from hil.probe.procedure import measure_run_out
from hil.probe.wiring import probe_bench
from hil.records.journal import Campaign
from sim_backends.bench import Bench, BenchParameters

TRAVEL_MM = (-2.0, 160.0)
MEASUREMENT = """
[drive]
backend = "bench"
machine = "{machine}"
seed = 5
{face}
[instrument]
place_temps = {{ screw = 4 }}

[measurement]
targets_mm = [20.0, 45.0, 70.0]
runs = {runs}
velocity_mm_s = 100.0
dwell_s = 0.1
reading_s = 0.1
home = {home}

[lost_motion]
stroke_mm = 4.0
places = 10
runs = 2
proof_moves = 4

[backlash]
reference_plus_mm = 15.0
reference_minus_mm = 15.0
travel_velocity_mm_s = 100.0
step_um = 4.0
settle_s = 0.02
readings = 2
velocity_mm_s = 2.0
run_in_mm = 0.2
runs = 1
{backlash}
"""
OPTICS = "[instrument]\nbeside = { straightness_um = { axis = 2, per_unit = 11.5 } }\n"
STRAIGHTNESS = """
[straightness]
axis_file = "Y.toml"
at_mm = 45.0
"""
FACES = {
    "virtual": 'face = "virtual"\n',
    "canopen": 'face = "canopen"\n',
    "modbus-tcp": 'face = "modbus-tcp"\n',
    "modbus-rtu": 'face = "modbus-rtu"\n',
}
BACKLASH = {"canopen": 'parameter = "2201h"\nacceleration = "2202h"\nparameter_um = 0.01\n'}


class NotGoodError(BridgeError):
    """A verb ended without an error and reported a bad result."""


@dataclass
class Place:
    """The set-up of a verb. resume: continue an interrupted one; homing: lines of [drive]; parameters: of the benches.

    on_bench is called with each bench, and on_can with each drive's interceptor, before anything moves.
    """

    directory: Path
    face: str
    waiting: Waiting | None = None
    resume: bool = False
    homing: str = ""
    home: bool = True
    corrected: bool = True  # whether verify measures with correction
    guard_s: float | None = 1.0
    parameters: Callable[[AxisConfig], BenchParameters] | None = None
    on_bench: Callable[[Any], None] = lambda _bench: None
    on_can: Callable[[CanPeer], None] | None = None
    _axes: dict[str, AxisConfig] = field(default_factory=dict)

    def axis(self, name: str = "X", *, machine: str = "geometric", table: str = "", runs: int = 1) -> AxisConfig:
        """Write an axis file and the builder's keys, and read it."""
        if name in self._axes:
            return self._axes[name]
        path = self.directory / f"{name}.toml"
        face = FACES[self.face] + (
            f'correction_table = "{table}"\n' if table and self.face in ("virtual", "canopen") else ""
        )
        backlash = BACKLASH.get(self.face, "")
        text = AXIS.replace("502.0", f"{TRAVEL_MM[1]}").replace('"X"', f'"{name}"') + MEASUREMENT.format(
            machine=machine, home=str(self.home).lower(), face=face + self.homing, runs=runs, backlash=backlash
        )
        if machine == "bent":
            text = text.replace("[instrument]\n", OPTICS) + STRAIGHTNESS
        self.directory.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        key_path = path.with_name("builder.key")
        if not key_path.exists():
            key = new_key()
            save_private_key(key_path, key, PASSWORDS["HIL_KEY_PASSWORD"], cost=Cost(n=2, r=8, p=1))
            save_public_key(path.with_name("builder.pub"), key.public_key())
        axis = load_axis(path)
        guarded = replace(axis, drive=replace(axis.drive, guard_s=self.guard_s))
        self._axes[name] = guarded
        return guarded

    @contextmanager
    def bench(self, *axes: AxisConfig) -> Iterator[RunningBench | None]:
        """None: the product switches its own on."""
        if self.parameters is None:
            yield None
            return
        with running_bench(axes, [self.parameters(axis) for axis in axes], self.waiting) as running:
            yield running

    @contextmanager
    def wired(self) -> Iterator[None]:
        """The product's wiring, with an interceptor on its buses."""

        place = self

        class SeenBench(Bench):
            def __init__(self, *arguments: Any, **settings: Any) -> None:
                super().__init__(*arguments, **settings)
                place.on_bench(self)

        with ExitStack() as stack:
            for module in (hil.machine.bench_canopen, hil.probe.wiring):
                stack.enter_context(patch.object(module, "drives_in_turn", stand_in(self.on_can)))
            stack.enter_context(patch.object(hil.machine.bench_wiring, "Bench", SeenBench))
            yield


def store_of(axis: AxisConfig) -> SealedStore:
    return SealedStore.of(axis, PASSWORDS["HIL_PASSWORD"], PASSWORDS["HIL_KEY_PASSWORD"])


def some_tables(axis: AxisConfig) -> TableSet:
    places = np.array(axis.measurement.targets_mm)
    return TableSet(TableMode.BIDIRECTIONAL, DirectionalTable(places, 0.05 * places, 0.05 * places - 4.0))


# -- the verbs -----------------------------------------------------------------------------------------------------------
def calibrate(place: Place) -> None:
    axis = place.axis()
    with place.bench(axis) as bench, connected(axis, bench, waiting=place.waiting) as machine:
        run_calibration(machine, store_of(axis), resume=place.resume)


def verify(place: Place) -> None:
    axis = place.axis()
    with place.bench(axis) as bench, connected(axis, bench, waiting=place.waiting) as machine:
        run_verification(machine, Compensation(some_tables(axis)) if place.corrected else None, resume=place.resume)


def lost_motion(place: Place) -> None:
    axis = place.axis(machine="worn")
    how = axis.lost_motion
    assert how is not None
    with place.bench(axis) as bench, connected(axis, bench, waiting=place.waiting) as machine:
        run_lost_motion(machine, how, None, resume=place.resume)


def backlash(place: Place) -> None:
    axis = place.axis(machine="worn")
    how = axis.backlash
    assert how is not None
    with place.bench(axis) as bench, connected_drive(axis, bench, waiting=place.waiting) as drive:
        measure_backlash(drive, how, backlash_settings(axis, how, drive))


def close_loop(place: Place) -> None:
    axis = place.axis()
    turning = Turning(Exploration(runs=2, rows=6, warm_up_s=1.0), effects=ALL[:1])
    with place.bench(axis) as bench, connected(axis, bench, waiting=place.waiting) as machine:
        run_loop(machine, store_of(axis), turning, resume=place.resume)


def circle(place: Place) -> None:
    axes = [place.axis(name) for name in ("X", "Y")]
    period_s = 0.004 if place.face in ("virtual", "canopen") else 0.03
    with place.bench(*axes) as bench, connected_axes(axes, bench, place.waiting) as machines:
        sessions = [machine.session for machine in machines]
        prepare(sessions)
        drive_circle(sessions, Circle((45.0, 45.0), 6.0, 15.0, ramp_mm_s2=100.0), (None, None), period_s=period_s)


def straightness(place: Place) -> None:
    place.axis("Y")
    axis = place.axis(machine="bent", runs=2)
    axis = replace(axis, measurement=replace(axis.measurement, targets_mm=(20.0, 45.0, 70.0, 100.0, 140.0)))
    # the bench's way is straight within 160 mm, so that little is gained
    with suppress(UnprovenError), connected_across(axis, waiting=place.waiting) as machine:
        run_straightness(machine, store_of(axis), None, None, resume=place.resume)


def doctor_check(place: Place) -> None:
    axis = place.axis()
    with place.bench(axis) as bench, connected(axis, bench, waiting=place.waiting) as machine:
        wrong = [check for check in doctor(machine.session, trust_file=True) if not check.good]
    if wrong:
        raise NotGoodError("; ".join(f"{check.name}: {check.detail}" for check in wrong))


def table_proof(place: Place) -> None:
    axis = place.axis(table="simulated_array")
    compensation = Compensation(some_tables(axis))
    with place.bench(axis) as bench, connected(axis, bench, waiting=place.waiting) as machine:
        table = held_table(machine.session.drive)
        table.write(drive_table(wanted_of(compensation), table.description, axis.scaling, axis.limits).raw)
        campaign = Campaign.numbered(axis.store.directory, {"kind": "proof"}, resume=False)
        proof = prove_by_instrument(machine.session, campaign, compensation, [45.0], runs=1)
    if not proof.good:
        raise NotGoodError(proof.verdict)


def probe(place: Place) -> None:
    drive = {"virtual": probe_files.VIRTUAL, "canopen": probe_files.CANOPEN, "modbus-tcp": probe_files.MODBUS}[
        place.face
    ]
    config = load_probe_machine(probe_files.lay_out(place.directory, drive=drive, block="turns = 1"))
    guarded: dict[str, Any] = {
        name: replace(axis, drive=replace(axis.drive, guard_s=place.guard_s)) for name, axis in config.axes.items()
    }
    config = replace(config, **guarded)
    bench = probe_bench(config, waiting=place.waiting)
    place.on_bench(bench)
    with connected_probe(config, bench=bench) as session:
        measured = measure_run_out(session)
    if (refusal := measured.refusal(config)) is not None:
        raise NotGoodError(refusal)


Verb = Callable[[Place], None]
VERBS: dict[str, Verb] = {
    "calibrate": calibrate,
    "verify": verify,
    "lost-motion": lost_motion,
    "backlash": backlash,
    "close-loop": close_loop,
    "circle": circle,
    "straightness": straightness,
    "doctor": doctor_check,
    "table proof": table_proof,
    "probe": probe,
}
WITH_INSTRUMENT = tuple(name for name in VERBS if name not in ("backlash", "probe"))
