"""The bench in place of a machine: its servos behind the face that the axis files name, and its instrument."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from drivers.clock import Waiting
from drivers.drive import ServoDrive
from drivers.errors import CapabilityError, InputError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from hil.axis.axis_file import AxisConfig, DriveAxis, InstrumentConfig
from hil.machine.instruments import build_instrument
from hil.machine.likeness import read_likeness
from hil.machine.links import guarded
from hil.machine.machine import Machine, session_of
from sim_backends.bench import Bench, BenchParameters, known_bench
from sim_backends.clock import SimClock
from sim_backends.gauge import GaugeParameters
from sim_backends.likeness import alike
from sim_backends.own_table import TableForm, known_table
from sim_backends.plant.axis import FeedAxis
from sim_backends.virtual_drive import VirtualDrive, VirtualDriveSettings

if TYPE_CHECKING:  # a verb loads the wire that its axis file names
    from sim_backends.canopen_in_turn import DrivesInTurn

PULSES_HZ = 10.0
"""Rate of the bench's pulse generator on the external input of a display, Hz."""

STRAIGHTNESS = "straightness_um"
"""The column of [instrument] beside for which the bench has straightness optics, on axis 2 of its display."""


def bench_parameters(axis: DriveAxis) -> BenchParameters:
    """The simulated machine that an axis file with backend "bench" names. Raises InputError as `read_likeness` and `alike`."""
    if axis.drive.like is not None:
        return alike(read_likeness(axis.drive.like))
    return known_bench(axis.drive.machine, axis.drive.seed)


@dataclass(frozen=True)
class RunningBench:
    """The simulated axes of one machine, on one clock; they stay while drives are connected and disconnected.

    can: the bus that their servos are nodes of, None with another face
    """

    benches: Sequence[Bench]
    can: DrivesInTurn | None

    def drives(self, axes: Sequence[DriveAxis], stack: ExitStack) -> Sequence[ServoDrive]:
        """A connection to each drive, on the wire that the axis files name."""
        clock = self.benches[0].clock
        axes = _on_one_wire(axes)
        pairs = list(zip(axes, self.benches, strict=True))
        if axes[0].drive.face == "virtual":
            return [virtual_drive(*pair) for pair in pairs]
        if self.can is not None:
            from hil.machine.bench_canopen import canopen_drives  # noqa: PLC0415  (a verb loads the wire its axis file names)

            return canopen_drives(axes, self.can, clock, stack)
        from hil.machine.bench_modbus import modbus_drives  # noqa: PLC0415  (as above)

        return modbus_drives({axis.drive.unit: (axis, bench) for axis, bench in pairs}, clock, stack)

    def machine(self, axis: AxisConfig, bench: Bench, drive: ServoDrive) -> Machine:
        instrument = build_instrument(axis.instrument, bench.laser_path, bench.clock)
        conditions = BenchConditions(bench.plant, axis.conditions.levels)
        return Machine(axis, session_of(axis, drive, instrument, conditions), bench)

    def machines(self, axes: Sequence[AxisConfig], stack: ExitStack) -> tuple[Machine, ...]:
        """A connection to each drive with its instrument."""
        return tuple(map(self.machine, axes, self.benches, self.drives(axes, stack)))


@contextmanager
def running_bench(
    axes: Sequence[DriveAxis], parameters: Sequence[BenchParameters] | None = None, waiting: Waiting | None = None
) -> Iterator[RunningBench]:
    """The simulated axes of one machine, switched on for a `with` block; two axes are at right angles.

    parameters: in place of those that the axis files name. Raises as `bench_parameters`, `with_instrument` and `make_bench`.
    """
    wanted = [
        with_instrument(one, axis.instrument) if isinstance(axis, AxisConfig) else one
        for axis, one in zip(axes, parameters or map(bench_parameters, axes), strict=True)
    ]
    clock = SimClock(wanted[0].step_s, waiting)
    with ExitStack() as stack:
        benches = [make_bench(axis, one, clock, stack) for axis, one in zip(axes, wanted, strict=True)]
        if len(benches) == 2:
            benches[0].cross(benches[1])
        can = None
        if axes[0].drive.face == "canopen":
            from hil.machine.bench_canopen import canopen_bus  # noqa: PLC0415  (a verb loads the wire its axis file names)

            nodes = [(axis, one, bench_table(axis, one)) for axis, one in zip(_on_one_wire(axes), benches, strict=True)]
            can = canopen_bus(nodes, benches[0].clock, stack)
        yield RunningBench(benches, can)


def _on_one_wire(axes: Sequence[DriveAxis]) -> Sequence[DriveAxis]:
    """Of several, nodes 1, 2 … of one bus, units 1, 2 … of one line."""
    if len(axes) == 1:
        return axes
    return [replace(axis, drive=replace(axis.drive, node_id=n, unit=n)) for n, axis in enumerate(axes, start=1)]


def make_bench(axis: DriveAxis, parameters: BenchParameters, clock: SimClock, stack: ExitStack) -> Bench:
    """The bench of one axis. Raises InputError for an axis file whose scaling or travel is not the bench's."""
    _check(axis, parameters)
    return stack.enter_context(Bench(parameters, clock=clock))


def virtual_drive(axis: DriveAxis, bench: Bench) -> VirtualDrive:
    """A drive that calls the bench's servo directly, without a wire."""
    asked = axis.drive.homing
    settings = VirtualDriveSettings(acceleration_mm_s2=axis.limits.max_acceleration_mm_s2)
    given = {
        "homing_method": asked.method,
        "homing_speed_switch_mm_s": asked.speed_switch_mm_s,
        "homing_speed_zero_mm_s": asked.speed_zero_mm_s,
        "home_position_mm": asked.home_position_mm,
    }
    settings = replace(settings, **{name: value for name, value in given.items() if value is not None})  # type: ignore[arg-type]
    drive = VirtualDrive(
        bench.servo,
        axis.scaling,
        axis.limits,
        bench.clock,
        name=axis.name,
        settings=settings,
        table=bench_table(axis, bench),
    )
    return guarded(axis, drive)


def bench_table(axis: DriveAxis, bench: Bench) -> TableForm | None:
    """The correction table in the bench's drive, None where the axis file names none."""
    return known_table(axis.drive.correction_table, bench.parameters.scaling.counts_per_load_mm / 1000.0)


def _check(axis: DriveAxis, parameters: BenchParameters) -> None:
    """Raises InputError for an axis file whose scaling or travel is not the bench's."""
    found: tuple[AxisScaling, DriveLimits] = (parameters.scaling, parameters.limits)
    if axis.drive.profile:
        from sim_backends.canopen_quirks import profile_counts  # noqa: PLC0415  (a profile is one of a CANopen drive)
        from sim_backends.drive_profiles import load_profile  # noqa: PLC0415  (as above)

        counts = profile_counts(load_profile(axis.drive.profile), parameters)
        found = (replace(found[0], encoder_counts_per_motor_rev=counts), found[1])
    if axis.scaling != found[0]:
        raise InputError(
            f"[scaling] does not describe the bench: expected encoder_counts_per_motor_rev ="
            f" {found[0].encoder_counts_per_motor_rev}, feed_mm_per_shaft_rev = {found[0].feed_mm_per_shaft_rev:g}",
            path=axis.path,
        )
    limits = axis.limits
    if limits.travel_min_mm < found[1].travel_min_mm or limits.travel_max_mm > found[1].travel_max_mm:
        raise InputError(
            f"[axis] travel {limits.travel_min_mm:g} to {limits.travel_max_mm:g} mm exceeds the bench's"
            f" {found[1].travel_min_mm:g} to {found[1].travel_max_mm:g} mm",
            path=axis.path,
        )


def with_instrument(parameters: BenchParameters, config: InstrumentConfig) -> BenchParameters:
    """The bench's parameters with the instrument of the axis file. Raises InputError for an instrument that the bench cannot
    simulate."""
    if config.trigger_input is not None:
        parameters = replace(parameters, trigger_input=config.trigger_input)
    if (beside := (config.beside or {}).get(STRAIGHTNESS)) is not None:
        laser = replace(parameters.laser, straightness_um_per_unit=beside[1])
        parameters = replace(parameters, laser=laser)
    display = config.display
    if display is None:
        return parameters
    kind = "mitutoyo" if display.pattern == "mitutoyo" else config.kind
    if kind == "ascii" and (display.pattern != "number" or display.unit != "mm" or display.request):
        raise InputError("[instrument] the bench writes patterns number (in mm, without a request) and mitutoyo")
    pulse_hz = PULSES_HZ if display.pulsed else None
    gauge = parameters.gauge or GaugeParameters()
    resolution_mm = display.count_mm or gauge.resolution_mm
    return replace(parameters, gauge=replace(gauge, kind=kind, pulse_hz=pulse_hz, resolution_mm=resolution_mm))


class BenchConditions:
    """`Conditions` of the simulated axis. levels: of the axis file, load_kg in kg and pos_y_mm in mm.

    Raises CapabilityError for a condition that the bench cannot vary.
    """

    by_hand = False

    def __init__(self, axis: FeedAxis, levels: Mapping[str, Sequence[float]]) -> None:
        known = {"load_kg", "pos_y_mm"}
        if unknown := set(levels) - known:
            raise CapabilityError(
                f"the bench cannot vary {', '.join(sorted(unknown))}, only {', '.join(sorted(known))}"
            )
        self._axis = axis
        self._levels = {name: tuple(values) for name, values in levels.items()}

    @property
    def levels(self) -> Mapping[str, Sequence[float]]:
        """Column name -> levels of the axis file."""
        return self._levels

    def set(self, name: str, value: float) -> None:
        """Set load_kg or pos_y_mm at once. Raises CapabilityError for any other name."""
        if name == "load_kg":
            self._axis.load_kg = value
        elif name == "pos_y_mm":
            self._axis.other_axis_mm = value
        else:
            raise CapabilityError(f"the bench cannot set {name}")

    def read(self) -> Mapping[str, float]:
        """load_kg and pos_y_mm where the axis file varies them; pitch_urad and yaw_urad of the level, µrad."""
        now = {"load_kg": self._axis.load_kg, "pos_y_mm": self._axis.other_axis_mm}
        return {
            **{name: now[name] for name in self._levels},
            "pitch_urad": self._axis.pitch_urad,
            "yaw_urad": self._axis.yaw_urad,
        }
