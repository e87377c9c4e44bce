"""What the machine and its surroundings do while a plan is carried out: times, reversals, temperatures, air, angles,
torque.

A `State` holds the true quantities, one array of shape (n,) per captured row; `logged` gives what a workshop would
read of them, with the noise and resolution of each sensor. First-order heat flow by the energy each move brings in;
air by the short formula for its refractive index (n - 1 = 7.86e-4 p/(273 + t) - 1.5e-11 RH (t² + 160), p in kPa; NIST
Engineering Metrology Toolbox, "shop floor" formula).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from study.grammar.campaign import FLY, UNSEEN, Axis, Move

Floats = NDArray[np.float64]
PLACES = ("screw", "nut", "bearing", "bed", "motor", "coolant")


@dataclass(frozen=True)
class Heat:
    """One place: its share of the friction's heat (K per mm/s at balance), its time constant, its share of the room's
    swing.
    """

    gain_k_s_mm: float
    time_constant_s: float
    room_share: float
    own_swing_k: float
    own_period_s: float


@dataclass(frozen=True)
class Machine:
    """Constants of a machine's surroundings, the same in every campaign."""

    heats: Mapping[str, Heat]
    angle_urad: tuple[float, ...]  # static shape of the pitch angle: amplitudes of three slow waves
    angle_load_urad_kg: float
    angle_temp_urad_k: float
    friction_percent: float
    torque_percent_kg: float


@dataclass(frozen=True)
class State:
    """True quantities, shape (n,) each; `path_mm` are all ends of moves, `path_row` the path index of each row."""

    axis: Axis
    run: Floats
    x_mm: Floats
    direction: Floats
    time_s: Floats
    velocity_mm_s: Floats
    since_reversal_mm: Floats
    stroke_mm: Floats
    load_kg: Floats
    y_mm: Floats
    z_mm: Floats
    temperature_c: Mapping[str, Floats]
    air_temp_c: Floats
    air_pressure_hpa: Floats
    air_humidity_percent: Floats
    pitch_urad: Floats
    yaw_urad: Floats
    torque_percent: Floats
    path_mm: Floats
    path_row: NDArray[np.intp]
    key: tuple[int, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.x_mm)

    @property
    def u(self) -> Floats:
        """Position from -1 to 1 over the travel."""
        return 2.0 * self.x_mm / self.axis.travel_mm - 1.0

    @property
    def moving(self) -> NDArray[np.bool_]:
        return self.velocity_mm_s != 0.0

    @property
    def refractivity(self) -> Floats:
        """n - 1 of the air, less its value at 20 °C, 1013.25 hPa and 50 %."""
        return refractivity(self.air_temp_c, self.air_pressure_hpa, self.air_humidity_percent) - refractivity(
            20.0, 1013.25, 50.0
        )


def refractivity(temp_c: Floats | float, pressure_hpa: Floats | float, humidity_percent: Floats | float) -> Floats:
    """n - 1 of air at 633 nm by the shop-floor formula named above."""
    kpa = np.asarray(pressure_hpa) / 10.0
    celsius = np.asarray(temp_c)
    return np.asarray(7.86e-4 * kpa / (273.0 + celsius) - 1.5e-11 * np.asarray(humidity_percent) * (celsius**2 + 160.0))


def draw_machine(rng: Generator) -> Machine:
    """Thermal and mechanical constants; the places differ in speed and in what heats them."""
    heats = {}
    for place, (gain, tau) in {
        "screw": (0.045, 1500.0),
        "nut": (0.06, 500.0),
        "bearing": (0.05, 900.0),
        "bed": (0.01, 7000.0),
        "motor": (0.12, 1200.0),
        "coolant": (0.005, 3000.0),
    }.items():
        heats[place] = Heat(
            gain_k_s_mm=gain * float(rng.uniform(0.5, 1.8)),
            time_constant_s=tau * float(rng.uniform(0.5, 1.8)),
            room_share=float(rng.uniform(0.2, 0.9)),
            own_swing_k=float(rng.uniform(0.3, 1.5)) if place == "coolant" else float(rng.uniform(0.0, 0.1)),
            own_period_s=float(rng.uniform(300.0, 2500.0)),
        )
    return Machine(
        heats=heats,
        angle_urad=tuple(float(a) for a in rng.normal(0.0, (15.0, 8.0, 4.0))),
        angle_load_urad_kg=float(rng.uniform(-0.04, 0.04)),
        angle_temp_urad_k=float(rng.uniform(-6.0, 6.0)),
        friction_percent=float(rng.uniform(4.0, 15.0)),
        torque_percent_kg=float(rng.uniform(0.005, 0.03)),
    )


def slow_course(rng: Generator, time_s: Floats, swing: float) -> Floats:
    """A smooth course of time: a ramp and three slow waves, standard deviation about `swing`, shape of time_s."""
    span = max(float(time_s[-1]), 1.0)
    course = rng.normal() * 2.0 * time_s / span
    for _ in range(3):
        course = course + rng.normal() * 0.6 * np.sin(
            2.0 * np.pi * time_s / (span * rng.uniform(0.5, 2.5)) + rng.uniform(0.0, 6.3)
        )
    return np.asarray(swing * course)


def _walk(axis: Axis, moves: Sequence[Move]) -> dict[str, Floats]:
    """Time, travel since the reversal, stroke before it and mean speed at the end of each move."""
    here, ahead, since, stroke, now = moves[0].to_mm, 0.0, 0.0, 0.0, 0.0
    rows: list[tuple[float, ...]] = []
    for move in moves:
        way = move.to_mm - here
        side = float(np.sign(way)) or ahead
        if side != ahead:
            stroke, since, ahead = since, 0.0, side
        since += abs(way)
        took = abs(way) / move.feed_mm_s + (0.0 if move.capture == FLY else move.feed_mm_s / axis.acceleration_mm_s2)
        now += took + move.dwell_s
        rows.append(
            (now, side, since, stroke, abs(way) / max(took + move.dwell_s + move.pause_s, 1e-9), took + move.dwell_s)
        )
        now += move.pause_s
        here = move.to_mm
    return dict(zip(("time", "side", "since", "stroke", "speed", "took"), np.array(rows).T, strict=True))


def carry_out(
    rng: Generator, machine: Machine, axis: Axis, moves: Sequence[Move], *, heat: float, room_k: float
) -> State:
    """The state at every captured row. `heat` scales the friction's heat, `room_k` is the swing of the room's
    temperature.
    """
    walk = _walk(axis, moves)
    room = slow_course(rng, walk["time"], room_k)
    pauses = np.array([move.pause_s for move in moves])
    warm = float(rng.choice([0.0, rng.uniform(0.2, 0.9)]))  # cold, or used before
    temperature = {}
    usual = float(np.mean(axis.feeds_mm_s)) * 0.4
    for place, one in machine.heats.items():
        level = warm * heat * one.gain_k_s_mm * usual
        course = np.empty(len(moves))
        for index in range(len(moves)):
            keep = np.exp(-(walk["took"][index]) / one.time_constant_s)
            level = level * keep + (1.0 - keep) * heat * one.gain_k_s_mm * walk["speed"][index]
            course[index] = level
            level *= np.exp(-pauses[index] / one.time_constant_s)
        swing = one.own_swing_k * np.sin(2.0 * np.pi * walk["time"] / one.own_period_s + rng.uniform(0, 6.3))
        temperature[place] = 20.0 + one.room_share * room + course + swing
    seen = np.array([move.capture != UNSEEN for move in moves])
    air = {
        "temp": 20.0 + room + rng.normal(0.0, 0.5),
        "pressure": rng.uniform(985.0, 1030.0) + slow_course(rng, walk["time"], rng.uniform(0.5, 5.0)),
        "humidity": np.clip(rng.uniform(35.0, 60.0) + slow_course(rng, walk["time"], 3.0), 5.0, 95.0),
    }
    x = np.array([move.to_mm for move in moves])
    u = 2.0 * x / axis.travel_mm - 1.0
    load = np.array([move.setting.load_kg for move in moves])
    angle = sum(a * np.sin((k + 1) * u * 1.7 + k) for k, a in enumerate(machine.angle_urad))
    angle = (
        angle + machine.angle_load_urad_kg * load * (0.4 + u) + machine.angle_temp_urad_k * (temperature["bed"] - 20.0)
    )
    yaw = 0.6 * sum(a * np.cos((k + 1) * u * 1.3) for k, a in enumerate(machine.angle_urad))
    yaw = (
        yaw + 0.7 * machine.angle_load_urad_kg * (load - 100.0) * (1.0 - 0.5 * u) + slow_course(rng, walk["time"], 3.0)
    )
    fly = np.array([move.capture == FLY for move in moves])
    speed = walk["side"] * np.array([move.feed_mm_s for move in moves]) * fly
    torque = walk["side"] * (machine.friction_percent + machine.torque_percent_kg * load) + 0.05 * speed
    return State(
        axis=axis,
        run=np.array([float(move.run) for move in moves])[seen],
        x_mm=x[seen],
        direction=walk["side"][seen],
        time_s=walk["time"][seen],
        velocity_mm_s=speed[seen],
        since_reversal_mm=walk["since"][seen],
        stroke_mm=walk["stroke"][seen],
        load_kg=load[seen],
        y_mm=np.array([move.setting.y_mm for move in moves])[seen],
        z_mm=np.array([move.setting.z_mm for move in moves])[seen],
        temperature_c={place: course[seen] for place, course in temperature.items()},
        air_temp_c=air["temp"][seen],
        air_pressure_hpa=air["pressure"][seen],
        air_humidity_percent=air["humidity"][seen],
        pitch_urad=np.asarray(angle)[seen] + rng.normal(0.0, 0.3, int(seen.sum())),
        yaw_urad=np.asarray(yaw)[seen] + rng.normal(0.0, 0.3, int(seen.sum())),
        torque_percent=torque[seen] + rng.normal(0.0, 0.4, int(seen.sum())),
        path_mm=x,
        path_row=np.flatnonzero(seen),
    )


def logged(rng: Generator, state: State, error_um: Floats, columns: Sequence[str]) -> dict[str, Floats]:
    """What is written down: required columns, and those of `columns` with their sensors' noise and resolution."""
    n = len(state)

    def read(values: Floats, sd: float, step: float) -> Floats:
        return np.asarray(np.round((values + rng.normal(0.0, sd, n)) / step) * step)

    every: dict[str, Floats] = {
        "time_s": np.round(state.time_s, 2),
        "velocity_mm_s": state.velocity_mm_s,
        "since_reversal_mm": np.round(state.since_reversal_mm, 5),
        "stroke_mm": np.round(state.stroke_mm, 5),
        "torque_percent": read(state.torque_percent, 0.0, 0.1),
        "load_kg": state.load_kg,
        "pos_y_mm": state.y_mm,
        "pos_z_mm": state.z_mm,
        "pitch_urad": read(state.pitch_urad, 0.05, 0.01),
        "yaw_urad": read(state.yaw_urad, 0.05, 0.01),
        "air_temp_c": read(state.air_temp_c, 0.02, 0.01),
        "air_pressure_hpa": read(state.air_pressure_hpa, 0.05, 0.01),
        "air_humidity_percent": read(state.air_humidity_percent, 0.2, 0.1),
    }
    every.update({f"temp_{place}_c": read(course, 0.03, 0.01) for place, course in state.temperature_c.items()})
    rows = {
        "run": state.run,
        "direction": state.direction,
        "target_mm": np.round(state.x_mm, 5),
        "measured_mm": np.round(np.round(state.x_mm, 5) + error_um / 1000.0, 7),
    }
    return rows | {name: values for name, values in every.items() if name in columns}


OPTIONAL = (
    "time_s",
    "velocity_mm_s",
    "since_reversal_mm",
    "stroke_mm",
    "torque_percent",
    "load_kg",
    "pos_y_mm",
    "pos_z_mm",
    "pitch_urad",
    "yaw_urad",
    "air_temp_c",
    "air_pressure_hpa",
    "air_humidity_percent",
    *(f"temp_{place}_c" for place in PLACES),
)
