"""Machines with known lost motion, as a laser on the table measures it, and the torque that a drive shows of them."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import numpy as np

from hil.backlash.trace import ReversalTrace, crept_trace
from sim_backends.bench import BenchParameters
from sim_backends.plant.axis import FeedAxis
from sim_backends.plant.drive_train import DriveTrain, Guide
from sim_backends.plant.parameters import Friction, PlantParameters
from sim_backends.plant.screw import Screw
from sim_backends.servo import ServoParameters

TICK_S = 0.005


@dataclass(frozen=True)
class PublishedMachine:
    """A case of CN103561904: lost motion by the laser there, and the accuracy that the document states for its own machine.

    train: a machine of ours with that lost motion. What the document's machine showed is no result for it to come to.
    """

    name: str
    laser_um: float
    published_accuracy_percent: float
    train: DriveTrain
    load_kg: float = 0.0


NOISE_PERMILLE = 1.0
"""Noise (standard deviation) of one torque reading, 0.1 % of rated: that of the bench's servo, chosen before any comparison."""

PUBLISHED = (
    PublishedMachine("53 µm", 53.0, 94.34, DriveTrain()),
    PublishedMachine(
        "36 µm",
        36.0,
        91.67,
        DriveTrain(nut_n_per_um=42.09, screw_friction_n=80.0, guide=Guide(sliding_n=560.0)),
    ),
    PublishedMachine(
        "60 µm, 15 t",
        60.0,
        86.67,
        DriveTrain(nut_n_per_um=38.55, guide=Guide(sliding_n=300.0, per_kg_n=0.04)),
        load_kg=15_000.0,
    ),
)


def plant_of(train: DriveTrain) -> PlantParameters:
    """A machine whose only error is that of its drive train."""
    return PlantParameters(screw=Screw(lead_mm=10.0), friction=Friction(table_permille=0.0), drive_train=train)


def bench_of(machine: PublishedMachine, seed: int) -> BenchParameters:
    """The same with a servo whose torque has this noise."""
    servo = ServoParameters(torque_noise_permille=NOISE_PERMILLE, seed=seed)
    return BenchParameters(plant=plant_of(machine.train), servo=servo)


def some_train(seed: int) -> DriveTrain:
    """A random machine (stiffness, friction, break-away, guideway) with 20 to 90 µm of lost motion."""
    rng = random.Random(seed)
    return DriveTrain(
        coupling_n_per_um=rng.uniform(80.0, 200.0),
        nut_n_per_um=rng.uniform(30.0, 60.0),
        hardening_per_um=rng.uniform(0.0, 0.006),
        gap_um=rng.choice((0.0, 0.0, rng.uniform(1.0, 6.0))),
        screw_friction_n=rng.uniform(50.0, 200.0),
        guide=Guide(
            sliding_n=rng.uniform(500.0, 1100.0),
            static_excess=rng.uniform(0.02, 0.15),
            bond_um=rng.uniform(1.0, 4.0),
            heal_s=rng.uniform(1.5, 6.0),
            stribeck_mm_s=rng.uniform(2.0, 8.0),
            bristle_n_per_um=rng.uniform(9000.0, 25_000.0),
        ),
    )


class _Crept:
    """A plant whose motor is moved directly."""

    def __init__(self, train: DriveTrain, load_kg: float) -> None:
        self.axis = FeedAxis(plant_of(train))
        self.axis.load_kg = load_kg
        self.at_um = 0.0

    def creep(self, to_um: float, um_per_s: float) -> None:
        while self.at_um != to_um:
            left = to_um - self.at_um
            step = um_per_s * TICK_S
            self.at_um = to_um if abs(left) <= step else self.at_um + (step if left > 0.0 else -step)
            self.axis.step(self.at_um / 10_000.0, TICK_S)

    def rest(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.axis.step(self.at_um / 10_000.0, TICK_S)


def laser_lost_motion_um(train: DriveTrain, load_kg: float = 0.0) -> float:
    """Position of the table by a laser at one motor position, reached downwards, minus the same reached upwards, µm: no torque."""
    machine = _Crept(train, load_kg)
    machine.creep(200.0, 500.0)
    machine.rest(0.5)
    upwards_mm = machine.axis.position_mm
    machine.creep(400.0, 500.0)
    machine.creep(200.0, 500.0)
    machine.rest(0.5)
    return (machine.axis.position_mm - upwards_mm) * 1000.0


@dataclass(frozen=True)
class TorqueCurve:
    """Torque without noise, 0.1 % of rated, signed as the axis: at rest after each step of 1 µm, the first at the reversal, and after
    each longer way; behind_permille: at rest after a way in either direction."""

    direction: int
    steps_permille: np.ndarray
    slides_permille: np.ndarray
    behind_permille: tuple[float, float] = (0.0, 0.0)


def torque_curve(train: DriveTrain, direction: int, load_kg: float = 0.0, *, steps: int = 130) -> TorqueCurve:
    """The torque curve through one reversal into `direction`."""
    machine, behind = _run_in(train, direction, load_kg)
    torques = [machine.axis.friction_permille]
    for index in range(1, steps + 1):
        machine.creep(float(direction * index), 100.0)
        machine.rest(0.1)
        torques.append(machine.axis.friction_permille)
    slides = []
    for index in range(1, 9):
        machine.creep(direction * (steps + 100.0 * index), 500.0)
        machine.rest(0.1)
        slides.append(machine.axis.friction_permille)
    return TorqueCurve(direction, np.array(torques), np.array(slides), behind)


def _run_in(train: DriveTrain, direction: int, load_kg: float) -> tuple[_Crept, tuple[float, float]]:
    """The machine at 0, reached against `direction`, and the torques at rest on both ways there."""
    machine = _Crept(train, load_kg)
    machine.creep(500.0 * direction, 500.0)
    machine.rest(0.3)
    ahead = machine.axis.friction_permille
    machine.creep(0.0, 300.0)
    machine.rest(0.3)
    return machine, (ahead, machine.axis.friction_permille)


MOTOR_FRICTION_PERMILLE, COGGING_PERMILLE, COGGING_UM = 15.0, 0.6, 1250.0
"""Of the motor itself while it turns, as of the bench's servo: eight times in a revolution of 10 mm."""


@dataclass(frozen=True)
class CreptCurve:
    """Torque without noise, 0.1 % of rated, and the motor's position, mm, every `TICK_S` of a creep from rest."""

    direction: int
    um_per_s: float
    position_mm: np.ndarray
    permille: np.ndarray
    behind_permille: tuple[float, float]


def crept_curve(
    train: DriveTrain, direction: int, load_kg: float = 0.0, *, reach_um: float = 130.0, um_per_s: float = 20.0
) -> CreptCurve:
    """The torque while the motor creeps through one reversal into `direction`."""
    machine, behind = _run_in(train, direction, load_kg)
    places, torques = [0.0], [machine.axis.friction_permille]
    while abs(machine.at_um) < reach_um:
        machine.creep(machine.at_um + direction * um_per_s * TICK_S, um_per_s)
        motor = direction * MOTOR_FRICTION_PERMILLE
        motor += COGGING_PERMILLE * math.sin(math.tau * machine.at_um / COGGING_UM)
        places.append(machine.at_um / 1000.0)
        torques.append(machine.axis.friction_permille + motor)
    return CreptCurve(direction, um_per_s, np.array(places), np.array(torques), behind)


def noisy_crept_trace(curve: CreptCurve, noise_permille: float, rng: np.random.Generator) -> ReversalTrace:
    """The creep as a drive shows it, by the averaging of the procedure."""
    shown = np.round(curve.permille + rng.normal(0.0, noise_permille, len(curve.permille))) / 10.0
    weight = _weight_percent(curve.behind_permille, noise_permille, rng)
    return crept_trace(
        curve.direction, curve.position_mm, shown, step_um=1.0, creep_um_s=curve.um_per_s, weight_percent=weight
    )


def _weight_percent(behind: tuple[float, float], noise_permille: float, rng: np.random.Generator) -> float:
    """Half the sum of the torques left behind, four readings each."""
    return float(np.mean(np.round(np.array(behind)[:, None] + rng.normal(0.0, noise_permille, (2, 4))))) / 10.0


def noisy_trace(
    curve: TorqueCurve, noise_permille: float, rng: np.random.Generator, readings: int = 4
) -> ReversalTrace:
    """The curve as a drive shows it: white noise, whole tenths of a per cent of rated torque (6077h)."""
    steps, slides = (
        np.round(true[:, None] + rng.normal(0.0, noise_permille, (len(true), readings))) / 10.0
        for true in (curve.steps_permille, curve.slides_permille)
    )
    position_mm = curve.direction * np.arange(len(steps)) / 1000.0
    weight = _weight_percent(curve.behind_permille, noise_permille, rng)
    return ReversalTrace(curve.direction, position_mm, steps, slides, weight)
