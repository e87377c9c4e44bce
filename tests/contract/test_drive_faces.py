"""What stands beside moves - touch probe, parameters, velocity runs, set-point streams - on every wire: it works, or the capability
says no before anything moves. One suite, run unchanged against each backend of `support.drive_rigs`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import pytest
from support.drive_rigs import COUNTS_PER_REV, Backend, Rig, arrive, home

from drivers.drive import Capability, DriveState
from drivers.errors import CapabilityError, InputError, LimitError, SafetyError, StateError
from drivers.parameters import DriveParameters, ParameterKind
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from drivers.touch_probe import Edge, Latch

COUNTS_PER_MM = 10_000
PERIOD = SetPointSettings(0.03)  # longer than a serial line at 115200 baud takes for a write and a sample


@pytest.fixture
def rig(backend: Backend) -> Iterator[Rig]:
    """Reversed: what has no sign of its own shows."""
    with backend(AxisScaling(COUNTS_PER_REV, 10.0, direction=-1)) as rig:
        yield rig


def _says_no(rig: Rig, capability: Capability, refused: Callable[[], object]) -> bool:
    """Whether the drive lacks it; then the call is refused, and nothing has moved."""
    if capability in rig.drive.capabilities:
        return False
    before = rig.servo.position_actual_counts
    with pytest.raises(CapabilityError, match=capability.value):
        refused()
    rig.run(0.2)
    assert rig.servo.position_actual_counts == before
    return True


# -- touch probe -------------------------------------------------------------------------------------------------------


def test_positions_are_latched_on_both_edges_of_both_probes(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        if _says_no(rig, Capability.TOUCH_PROBE, drive.touch_probe):
            return
        home(rig)
        assert rig.probe is not None
        rig.probe.attach(1, lambda counts: -counts / COUNTS_PER_MM >= 3.14159)
        rig.probe.attach(2, lambda counts: 7.0 <= -counts / COUNTS_PER_MM < 8.0)
        probe = drive.touch_probe()
        with pytest.raises(InputError, match="expected probe 1 or 2"):
            probe.arm(3, [Edge.POSITIVE])
        with pytest.raises(InputError, match="at least one edge"):
            probe.arm(1, [])
        probe.arm(1, [Edge.POSITIVE])
        probe.arm(2, [Edge.POSITIVE, Edge.NEGATIVE], continuous=True)
        assert probe.poll() == []

        def go(target_mm: float) -> list[Latch]:
            drive.start_move(target_mm, 100.0)
            arrive(rig)
            return probe.poll()

        out = go(12.0)
        assert [(latch.probe, latch.edge) for latch in out] == [
            (1, Edge.POSITIVE),
            (2, Edge.POSITIVE),
            (2, Edge.NEGATIVE),
        ]
        assert [latch.position_load_mm for latch in out] == pytest.approx([3.14159, 7.0, 8.0], abs=2e-4)
        stamps = [latch.device_stamp for latch in out]
        assert None not in stamps
        assert stamps == sorted(stamps)  # type: ignore[type-var]
        assert stamps[0] != stamps[1]
        assert all(latch.time_ns <= rig.clock.now_ns() for latch in out)
        back = go(0.0)  # the first probe was armed for one edge only, and has caught it
        assert [(latch.probe, latch.edge) for latch in back] == [(2, Edge.POSITIVE), (2, Edge.NEGATIVE)]
        assert [latch.position_load_mm for latch in back] == pytest.approx([8.0, 7.0], abs=2e-4)
        probe.disarm(2)
        assert go(12.0) == []


# -- parameters --------------------------------------------------------------------------------------------------------


def _one_to_change(parameters: DriveParameters) -> str:
    """A whole number that may be written and does not wear anything out, or any where all do."""
    found = [
        info
        for info in (parameters.describe(name) for name in parameters.names)
        if info.writable and info.kind is ParameterKind.INTEGER
    ]
    return min(found, key=lambda info: info.wears).name


def test_parameters_are_checked_written_and_proven(rig: Rig) -> None:
    with rig.drive as drive:
        drive.require(Capability.PARAMETERS)
        parameters = drive.parameters
        name = _one_to_change(parameters)
        info = parameters.describe(name)
        before = parameters.read(name)
        assert isinstance(before, int)
        assert info.low is not None
        assert info.high is not None
        assert info.low <= before <= info.high
        other = before + 1 if before < info.high else before - 1
        assert parameters.write(name, other) is True
        assert parameters.read(name) == other
        assert parameters.write(name, other) is False  # it holds that already
        for wrong in (int(info.high) + 1, int(info.low) - 1, 10**12, math.nan, "much", b"much"):
            with pytest.raises(InputError):
                parameters.write(name, wrong)
        assert parameters.read(name) == other
        assert parameters.write(name, before) is True
        for refused in (parameters.read, parameters.describe):
            with pytest.raises(InputError):
                refused("no_such_parameter")


def test_what_is_read_only_is_read_and_not_written(rig: Rig) -> None:
    with rig.drive as drive:
        parameters = drive.parameters
        fixed = [info for info in map(parameters.describe, parameters.names) if not info.writable]
        assert fixed
        text = [info for info in fixed if info.kind is ParameterKind.TEXT]
        assert any(str(parameters.read(info.name)) for info in text)
        with pytest.raises(CapabilityError):
            parameters.write(fixed[0].name, 1)


# -- set-points --------------------------------------------------------------------------------------------------------


def test_set_points_are_followed_and_moves_work_again(rig: Rig) -> None:
    with rig.drive as drive:
        drive.enable()
        if _says_no(rig, Capability.STREAMING, lambda: drive.stream(PERIOD)):
            return
        home(rig)
        with drive.stream(PERIOD) as stream:
            for step in range(1, 31):
                stream.cycle([0.3 * step])  # 10 mm/s
            for _ in range(5):
                stream.cycle([9.0])
            assert stream.missed_cycles == 0
            assert stream.found[0][1] == pytest.approx(9.0, abs=1e-3)
        assert drive.sample().state is DriveState.ENABLED
        drive.start_move(2.0, 100.0)
        assert arrive(rig) == pytest.approx(2.0, abs=1e-3)


def _stream(rig: Rig, *places_mm: float, thinking_s: float = 0.0) -> None:
    with rig.drive.stream(PERIOD) as stream:
        for place_mm in places_mm:
            stream.cycle([place_mm])
            rig.run(thinking_s)


def test_a_stream_stops_the_axis_when_it_goes_wrong(rig: Rig) -> None:
    with rig.drive as drive:
        if Capability.STREAMING not in drive.capabilities:
            return
        with pytest.raises(StateError), drive.stream(PERIOD):
            pytest.fail("entered while disabled")
        drive.enable()
        home(rig)
        with pytest.raises(LimitError, match="step of"):
            _stream(rig, 0.02, 7.0)  # 233 mm/s
        rig.run(0.5)
        assert drive.sample().state is not DriveState.ENABLED
        assert drive.sample().position_load_mm == pytest.approx(0.02, abs=0.02)
        drive.disable()
        drive.enable()
        with pytest.raises(SafetyError, match="missed in a row"):
            _stream(rig, 0.02, 0.02, thinking_s=5 * PERIOD.period_s)
        rig.run(0.5)
        assert drive.sample().velocity_mm_s == 0.0
