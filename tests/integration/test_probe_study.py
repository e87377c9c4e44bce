"""Random machines: run-out, radius and bore centre come out within a pulse, chips are refused, latching beats stepping.

What is expected is the simulated stylus's own description; the truth (sphere against tilted plane and cylinder) shares no code with
what is tested.
"""

from __future__ import annotations

import cmath
import math
import random
from dataclasses import replace
from pathlib import Path

import pytest
from support import probe_files
from support.probe_files import connected_probe

from hil.probe.machine_file import ProbeMachineConfig, load_probe_machine
from hil.probe.procedure import RunOutMeasurement, centre_bore, measure_run_out
from hil.probe.runout import CorrectionCode, RunOut
from hil.probe.wiring import probe_bench
from sim_backends.plant.touch_probe import Bore, Chip, Face, Stylus
from sim_backends.probe import ProbeParameters
from sim_backends.probe_bench import ProbeBench

PULSE_UM = 1.0


class Machine:
    """One random machine: its file as its owner would write it, and the truth behind it."""

    def __init__(
        self, directory: Path, seed: int, gap_mm: float, *, turns: int = 1, pulse_um: float = PULSE_UM
    ) -> None:
        rng = random.Random(seed)
        facing = rng.choice((1, -1))
        radius_mm = rng.uniform(0.5, 4.0)
        largest_mm = min(0.06, 0.4 * gap_mm)
        self.stylus = Stylus(
            radius_mm=radius_mm,
            offset_mm=(rng.uniform(-1, 1) * largest_mm, rng.uniform(-1, 1) * largest_mm),
            pretravel_mm=rng.uniform(0.0, 0.012),
            noise_mm=rng.uniform(0.0, 0.0002),
        )
        face = Face(
            (105.0, 40.0, 0.0),
            facing,
            tilt_z_rad=rng.uniform(-0.003, 0.003),
            tilt_y_rad=rng.uniform(-0.003, 0.003),
        )
        lean = complex(rng.uniform(-0.003, 0.003), rng.uniform(-0.003, 0.003))
        upright = math.sqrt(1.0 - abs(lean) ** 2)
        middle = (50.0 + rng.uniform(-0.3, 0.3), 60.0 + rng.uniform(-0.3, 0.3), 0.0)
        self.bore = Bore(middle, radius_mm + 1.0, (lean.real, lean.imag, upright))
        self.truth = ProbeParameters(self.stylus, (face, self.bore), seed=rng.getrandbits(32))
        self.zero_deg, self.sense = rng.uniform(-80.0, 80.0), rng.choice((1, -1))
        start_mm = 105.0 - facing * (radius_mm + gap_mm)
        path = probe_files.lay_out(
            directory,
            start_mm=start_mm,
            search_mm=gap_mm + 0.5,
            spindle=f"zero_deg = {self.zero_deg!r}\nsense = {self.sense}",
            probe=f"pretravel_mm = {self.stylus.pretravel_mm!r}\nposition_mm_s = 50.0\npulse_mm = {pulse_um / 1000!r}",
            block=f"turns = {turns}\nradius_limit_um = 10.0",
        )
        text = path.read_text().replace("tip_radius_mm = 2.0", f"tip_radius_mm = {radius_mm!r}")
        path.write_text(
            text.replace("velocity_deg_s = 180.0", "velocity_deg_s = 360.0").replace("reach_mm = 8.0", "reach_mm = 2.0")
        )
        self.config: ProbeMachineConfig = load_probe_machine(path)

    def measure(self, mode: str, *chips: Chip, play_mm: float = 0.0) -> RunOutMeasurement:
        bench = probe_bench(self.config, replace(self.truth, chips=chips, play_mm=play_mm))
        with connected_probe(self.config, mode=mode, bench=bench) as session:
            return measure_run_out(session)

    def in_bore(self) -> ProbeBench:
        return probe_bench(self.config, self.truth, in_bore=True)

    def errors_um(self, found: RunOut) -> tuple[float, float, float]:
        """Of x, y and radius: the ball as it stands where the spindle's drive is at what its owner calls zero."""
        ball = complex(*self.stylus.offset_mm) * cmath.exp(1j * math.radians(self.sense * self.zero_deg))
        return (
            1000 * (found.x_mm - ball.real),
            1000 * (found.y_mm - ball.imag),
            1000 * (found.tip_radius_mm - self.stylus.radius_mm),
        )


@pytest.fixture
def machines(pytestconfig: pytest.Config) -> int:
    return 40 * int(pytestconfig.getoption("--seeds"))


@pytest.mark.outside
@pytest.mark.parametrize(("mode", "gap_mm", "pulse_um"), [("latch", 0.3, 1.0), ("step", 0.03, 2.0)])
def test_run_out_and_radius_of_many_machines_within_a_pulse(
    tmp_path: Path, mode: str, gap_mm: float, pulse_um: float, machines: int
) -> None:
    worst = 0.0
    for seed in range(machines):
        machine = Machine(tmp_path, seed, gap_mm, pulse_um=pulse_um)
        measured = machine.measure(mode)
        assert measured.refusal(machine.config) is None, f"machine {seed}"
        worst = max(worst, *map(abs, machine.errors_um(measured.run_out)))
        assert worst <= pulse_um, f"machine {seed}: {machine.errors_um(measured.run_out)}"
    assert worst > 0.0
    print(f"{mode}: worst of {machines} machines {worst:.3f} µm")


@pytest.mark.outside
def test_a_corrected_bore_centre_within_a_pulse(tmp_path: Path, machines: int) -> None:
    worst = uncorrected = 0.0
    for seed in range(machines // 4):
        machine = Machine(tmp_path, 1000 + seed, 0.3)
        known = machine.measure("latch").run_out
        bench = machine.in_bore()
        with connected_probe(machine.config, touching=("x", "y"), bench=bench) as session:
            found = centre_bore(session, known, CorrectionCode.M93)
        true_x, true_y, _ = machine.bore.point_mm
        off = [1000 * (a - b) for a, b in zip(found.centring.centre_mm, (true_x, true_y), strict=True)]
        stands = [1000 * (bench.place(name) - true) for name, true in (("x", true_x), ("y", true_y))]
        worst = max(worst, *map(abs, off), *map(abs, stands))
        raw = [1000 * (a - b) for a, b in zip(found.centring.middle_mm, (true_x, true_y), strict=True)]
        uncorrected = max(uncorrected, *map(abs, raw))
        assert worst <= PULSE_UM, f"machine {1000 + seed}: {off}, {stands}"
        assert found.centring.diameter_mm == pytest.approx(2 * machine.bore.radius_mm, abs=2e-3)
    assert uncorrected > 30.0  # what it is there for
    print(f"bore centre: worst {worst:.3f} µm, without correction {uncorrected:.1f} µm")


@pytest.mark.outside
def test_a_chip_under_one_of_the_contacts_is_refused_by_the_closure(tmp_path: Path, machines: int) -> None:
    """A chip under any one contact, or under any three, from 5 to 300 µm thick."""
    refused = 0
    for seed in range(machines):
        rng = random.Random(seed)
        machine = Machine(tmp_path, 2000 + seed, 0.4)
        thickness_mm = 0.005 * 60.0 ** rng.random()
        first = rng.randrange(4)
        last = first if first > 1 or rng.random() < 0.5 else first + 2
        measured = machine.measure("latch", Chip(thickness_mm, first, last))
        (turn,) = measured.turns
        refused += abs(turn.closure_um) > machine.config.block.closure_limit_um
        assert "N0 + N180" in (measured.refusal(machine.config) or "N0 + N180")
    assert refused >= 0.99 * machines, refused
    print(f"closure: {refused} of {machines} chips refused")


@pytest.mark.outside
def test_any_chip_is_refused_by_the_checks_together(tmp_path: Path, machines: int) -> None:
    """A chip under any stretch of the contacts of two turns, flattened differently by each: all of them, too, which always close."""
    refused = closing = 0
    for seed in range(machines):
        rng = random.Random(seed)
        machine = Machine(tmp_path, 3000 + seed, 0.4, turns=2)
        first, last = sorted((rng.randrange(8), rng.randrange(8)))
        chip = Chip(0.02 * 15.0 ** rng.random(), first, last, give=rng.choice((0.0, 0.3)))
        measured = machine.measure("latch", chip)
        refused += measured.refusal(machine.config) is not None
        closing += all(abs(turn.closure_um) <= machine.config.block.closure_limit_um for turn in measured.turns)
    assert refused >= 0.99 * machines, refused
    assert closing > 0  # the closure alone does not see a chip under two neighbours, or under all
    print(f"all checks: {refused} of {machines} chips refused, {closing} of which close")


@pytest.mark.outside
def test_latching_is_twenty_times_faster_than_stepping_at_equal_accuracy(tmp_path: Path) -> None:
    """The same machine from the same start, 1 mm before the contact."""
    machine = Machine(tmp_path, 7, 1.0)
    machine.stylus = replace(machine.stylus, noise_mm=0.0001)
    machine.truth = replace(machine.truth, stylus=machine.stylus)
    latched, stepped = machine.measure("latch"), machine.measure("step")
    errors = {one.mode: max(map(abs, machine.errors_um(one.run_out))) for one in (latched, stepped)}
    assert errors["latch"] <= errors["step"] <= PULSE_UM
    assert stepped.seconds >= 20.0 * latched.seconds
    print(
        f"latch {latched.seconds:.1f} s, step {stepped.seconds:.1f} s: {stepped.seconds / latched.seconds:.0f} times; {errors}"
    )
