"""One axis of a stream with its frames, its latest feedback and its limits in counts. `stream` paces it and reacts to errors."""

from __future__ import annotations

import math

import can

from drivers.canopen.node import Node
from drivers.canopen.pdo import SYNC_EVERY, PdoSpec
from drivers.canopen.pdo_setup import PdoSetup
from drivers.cia402 import objects
from drivers.cia402.modes import Mode
from drivers.cia402.objects import Entry
from drivers.cia402.power import PowerStage
from drivers.cia402.state_machine import Command, Control, Status, decode_state
from drivers.drive import FAULTS, DriveState
from drivers.errors import BridgeError, DriveFaultError, FollowingErrorError, LimitError, StateError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings

TARGETS: dict[Mode, Entry] = {
    Mode.CYCLIC_POSITION: objects.TARGET_POSITION,
    Mode.INTERPOLATED_POSITION: objects.INTERPOLATION_TARGET,
}
RUNNING = 0x0027 | int(
    Status.FOLLOWS_COMMAND
)  # operation enabled, and the set-points are followed (interpolation active)
RUNNING_MASK = 0x006F | int(Status.FOLLOWS_COMMAND)


class StreamAxis:
    """One axis in the stream: its frames, its latest feedback, its limits in counts, precomputed for the cycle.

    mode: of this drive: interpolated position stands in for cyclic synchronous position. kind: the transmission type that its RPDO
    takes.
    stop: the RPDO that stops the drive at once, which the stream leaves in place; None where there is none. With it the set-points
    carry no controlword: one of "enable operation" each cycle would undo within a period what another master, a panel or the drive
    itself did to disable the axis. Interpolated position keeps it, as its bit 4 begins with the first set-point.
    """

    def __init__(
        self,
        node: Node,
        power: PowerStage,
        scaling: AxisScaling,
        limits: DriveLimits,
        settings: SetPointSettings,
        *,
        stop: PdoSpec | None,
        mode: Mode,
        kind: int = SYNC_EVERY,
    ) -> None:
        node_id = node.node_id
        self.mode = mode
        self._run = Command.ENABLE_OPERATION.word
        if mode is Mode.INTERPOLATED_POSITION:
            self._run |= Control.INTERPOLATE
        self.node = node
        self.power = power
        self.limits = limits
        self.settings = settings
        self.commanding = stop is None or mode is Mode.INTERPOLATED_POSITION
        carried = (objects.CONTROLWORD, TARGETS[mode]) if self.commanding else (TARGETS[mode],)
        self.rpdo = PdoSpec(1, False, 0x200 + node_id, kind, carried)
        self.tpdo = PdoSpec(1, True, 0x180 + node_id, SYNC_EVERY, (objects.STATUSWORD, objects.POSITION_ACTUAL))
        kept = () if stop is None else (stop,)
        self.setup = PdoSetup(node.sdo, node_id, (self.rpdo, self.tpdo, *kept), alone=True)
        self._pack_into = self.rpdo.codec.pack_into
        self._unpack_from = self.tpdo.codec.unpack_from
        self.message = can.Message(
            arbitration_id=self.rpdo.cob_id, data=bytes(self.rpdo.codec.size), is_extended_id=False
        )
        self.status = 0
        self.position_counts = 0
        self.heard_ns = 0
        self.fresh = False  # whether the answer to the last SYNC was received
        self.late_in_a_row = 0
        self.planned_counts = 0  # checked, sent next
        self.demand_counts = 0  # in force at the last SYNC
        self.next_counts = 0  # sent for the next one
        self.sync_period_before: int | None = None
        self.taken = False  # whether this stream controls the drive
        self.mm_per_count = scaling.direction * scaling.resolution_load_mm
        self.counts_per_mm = scaling.direction * scaling.counts_per_load_mm
        # one count of rounding at either end does not count as velocity
        self.max_step_counts = math.floor(limits.max_velocity_mm_s * settings.period_s * scaling.counts_per_load_mm) + 1
        self.travel_min_mm, self.travel_max_mm = limits.travel_min_mm, limits.travel_max_mm
        self.max_error_counts = math.floor(settings.following_error_mm * scaling.counts_per_load_mm)

    # -- frames ----------------------------------------------------------------------------------------------------------
    def receive(self, time_ns: int, data: bytes) -> None:
        if len(data) >= 6:
            self.status, self.position_counts = self._unpack_from(data)
            self.heard_ns = time_ns
            self.fresh = True

    def command(self, controlword: int) -> can.Message | None:
        """A command that stops the axis, as the RPDO of this axis: a message object of its own, as any thread may send it. None where
        the RPDO carries no controlword. The target is the last one.
        """
        if not self.commanding:
            return None
        data = self.rpdo.codec.pack(controlword, self.next_counts)
        return can.Message(arbitration_id=self.rpdo.cob_id, data=data, is_extended_id=False)

    # -- set-points ------------------------------------------------------------------------------------------------------
    def plan(self, position_load_mm: float) -> None:
        """Put the next set-point, load mm, into `message`. Raises LimitError for one outside the travel, or too far from the last."""
        if not self.travel_min_mm <= position_load_mm <= self.travel_max_mm:
            self.limits.check_target(position_load_mm)
        counts = round(position_load_mm * self.counts_per_mm)
        if abs(counts - self.next_counts) > self.max_step_counts:
            step_mm = abs(counts - self.next_counts) * abs(self.mm_per_count)
            raise LimitError(
                f"drive {self.node.name}: step of {step_mm:.6f} mm in one cycle is {step_mm / self.settings.period_s:g} mm/s,"
                f" allowed are {self.limits.max_velocity_mm_s:g} mm/s"
            )
        self.planned_counts = counts
        if self.commanding:
            self._pack_into(self.message.data, 0, self._run, counts)
        else:
            self._pack_into(self.message.data, 0, counts)

    # -- feedback --------------------------------------------------------------------------------------------------------
    def explain_error(self) -> FollowingErrorError:
        """The error of an axis too far from the set-point that was in force."""
        error_mm = abs(self.position_counts - self.demand_counts) * abs(self.mm_per_count)
        return FollowingErrorError(
            f"drive {self.node.name}: {error_mm:.3f} mm from its set-point,"
            f" allowed are {self.settings.following_error_mm:g} mm"
        )

    def explain_status(self) -> BridgeError:
        """The error of a statusword other than "enabled and following"."""
        state, name = decode_state(self.status), self.node.name
        if self.power.stopped:
            return StateError(f"drive {name} was told to stop while streaming")
        if state in FAULTS:
            code = self.node.monitor.last_error_code() or None
            return DriveFaultError(f"drive {name} went into {state.value} while streaming", code)
        if state is not DriveState.ENABLED:
            return StateError(f"drive {name} left operation enabled while streaming: {state.value}")
        return StateError(f"drive {name} does not follow the set-points (bit 12 is 0)")
