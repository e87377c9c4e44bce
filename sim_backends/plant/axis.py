"""The feed axis: motor revolutions in, the table's true position out.

Defines the order of the effects: reversal effects act on the motor's motion, errors of the screw on the nut's position, expansion and
guideway on the table. Errors are actual − commanded. No counts, protocols or corrections appear here.
"""

from __future__ import annotations

import random
from dataclasses import replace

from sim_backends.plant.ambient import Ambient
from sim_backends.plant.drive_train import WindUp
from sim_backends.plant.hysteresis import LostMotion, Reversal
from sim_backends.plant.parameters import PlantParameters
from sim_backends.plant.sensors import Sensors
from sim_backends.plant.thermal import Thermal

UM_PER_MM = 1000.0
TICK_S = 0.5  # interval at which heat, air and sensors are advanced, s


class FeedAxis:
    """The true state of one axis.

    `step` is exact for motions that do not reverse within it. `load_kg` and `other_axis_mm` are inputs that may be set at any time.
    `across`: the axis of the same machine at right angles to this one; how each of them leaves its line shows in the other's position.
    """

    def __init__(self, parameters: PlantParameters, motor_rev: float = 0.0) -> None:
        rng = random.Random(parameters.seed)
        self.load_kg = 0.0
        self.other_axis_mm = 0.0
        self.across: FeedAxis | None = None
        self.time_s = 0.0
        self.velocity_mm_s = 0.0
        self._loaded_kg = 0.0
        self._motor_mm = motor_rev * parameters.screw.lead_mm
        self._worked_mm = 0.0
        self._since_tick_s = 0.0
        self.ambient = Ambient(parameters.ambient, rng.getrandbits(32))
        self.thermal = Thermal(parameters.thermal, self.ambient.air_c)
        self.reversal = Reversal(parameters.backlash, parameters.lost_motion, self._motor_mm)
        self.wind_up = None if parameters.drive_train is None else WindUp(parameters.drive_train, self._motor_mm)
        self.sensors = Sensors(parameters.sensors, rng.getrandbits(32), self.thermal.state.screw_c)
        self.parameters = parameters
        self.reconfigure(parameters)
        self._sense(TICK_S)

    def reconfigure(self, parameters: PlantParameters) -> None:
        """Change the parameters while it runs; states (temperatures, wind-up) are kept."""
        self.parameters = parameters
        self._lead_mm = parameters.screw.lead_mm
        self.thermal.configure(parameters.thermal)
        self.ambient.configure(parameters.ambient)
        self.sensors.parameters = parameters.sensors
        self._configure_reversal()

    def _configure_reversal(self) -> None:
        self._loaded_kg = self.load_kg
        backlash, lost_motion = self.parameters.backlash, self.parameters.lost_motion
        growth = 1.0 + self.parameters.load.windup_per_100kg * self.load_kg / 100.0
        if growth != 1.0:
            backlash = replace(backlash, amount_um=backlash.amount_um * growth)
            lost_motion = LostMotion(tuple((t, s * growth) for t, s in lost_motion.elements))
        self.reversal.configure(backlash, lost_motion)

    # -- time --------------------------------------------------------------------------------------------------------
    def step(self, motor_rev: float, dt_s: float) -> None:
        """Turn the motor to `motor_rev` (revolutions) within dt_s > 0 seconds, without a reversal in between."""
        motor_mm = motor_rev * self._lead_mm
        moved = motor_mm - self._motor_mm
        if moved != 0.0:
            if self.load_kg != self._loaded_kg:
                self._configure_reversal()
            self._motor_mm = motor_mm
            self.reversal.step(motor_mm)
            self._worked_mm += abs(moved)
            self.velocity_mm_s = moved / dt_s
        else:
            self.velocity_mm_s = 0.0
        if self.wind_up is not None:
            self.wind_up.step(motor_mm, dt_s, self.load_kg)
        self.time_s += dt_s
        self._since_tick_s += dt_s
        if self._since_tick_s >= TICK_S:
            self._tick()

    def _tick(self) -> None:
        while self._since_tick_s >= TICK_S:
            worked = self._worked_mm * TICK_S / self._since_tick_s
            self._worked_mm -= worked
            self._since_tick_s -= TICK_S
            self.ambient.tick(TICK_S)
            self.thermal.step(worked, TICK_S, self.ambient.air_c)
            self._sense(TICK_S)

    def _sense(self, dt_s: float) -> None:
        state, ambient = self.thermal.state, self.ambient
        temps = {"screw": state.screw_c, "base": state.base_c, "head": ambient.air_c + state.head_inner_k}
        self.sensors.tick(dt_s, temps, ambient.air, self.load_kg)

    # -- truth -------------------------------------------------------------------------------------------------------
    @property
    def motor_mm(self) -> float:
        """The motor's position as nominal travel, mm."""
        return self._motor_mm

    @property
    def position_mm(self) -> float:
        """True position of the table, mm from the nominal zero."""
        p = self.parameters
        nut_mm = self.reversal.state.nut_mm
        if self.wind_up is not None:
            nut_mm -= self.wind_up.lag_um / UM_PER_MM
        if p.lost_motion.elements:
            nut_mm -= self.reversal.loss_um / UM_PER_MM
        if p.backlash.stribeck:
            nut_mm -= self.reversal.overshoot_um / UM_PER_MM
        error_um = (
            p.screw.error_um(self._motor_mm, nut_mm)
            + p.guideway.error_um(nut_mm)
            + p.load.error_um(nut_mm, self.load_kg)
            + p.cross_axis.error_um(nut_mm, self.other_axis_mm)
            + p.velocity_lag.error_um(self.velocity_mm_s)
            + p.slip.error_um(self.time_s)
            + self.thermal.head_drift_um
        )
        carried_um = 0.0 if self.across is None else self.across.straightness_um
        return nut_mm + self.thermal.expansion_mm(nut_mm) + (error_um + carried_um) / UM_PER_MM

    @property
    def straightness_um(self) -> float:
        """How far the table is from its straight way now, along + of the axis at right angles, µm."""
        return self.parameters.guideway.straightness_um.value(self.reversal.state.nut_mm)

    @property
    def lateral_um(self) -> float:
        """Where the measured point is across this axis, µm, with the axis at right angles, which may move it, where there is one."""
        return self.straightness_um if self.across is None else self.across.position_mm * UM_PER_MM

    @property
    def error_um(self) -> float:
        """True position − position by the motor, µm."""
        return (self.position_mm - self._motor_mm) * UM_PER_MM

    @property
    def friction_permille(self) -> float:
        """Torque that the table's friction and the wound-up screw put on the motor, 0.1 % of rated, with the motor's sign."""
        friction = self.parameters.friction
        ratio = self.reversal.wind_up_ratio
        excess = friction.stiction * ratio * ratio * ratio * self.reversal.breakaway(friction.breakaway_mm) * abs(ratio)
        wound_permille = 0.0 if self.wind_up is None else self.wind_up.torque_permille
        return wound_permille + friction.table_permille * (ratio + excess)

    # -- angles, for a level or an autocollimator on the table ---------------------------------------------------------
    @property
    def pitch_urad(self) -> float:
        """The table's pitch as a level measures it, µrad."""
        return self.parameters.guideway.pitch_urad.value(self._motor_mm) + self.sensors.readings.angle_noise_urad[0]

    @property
    def yaw_urad(self) -> float:
        """The table's yaw as an autocollimator measures it, µrad."""
        return self.parameters.guideway.yaw_urad.value(self._motor_mm) + self.sensors.readings.angle_noise_urad[1]
