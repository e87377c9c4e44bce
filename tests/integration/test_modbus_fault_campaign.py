"""Every fault of the wire, at any request of a whole job, on both wires and both shapes of drive.

A connection that is lost is one of a socket; the other faults pass through a line in this process, on which no time-out is waited for.

The job: enable, two moves, disable. Whatever happens, it ends; the axis never leaves its travel and no start is sent twice; and either
the job is done and the axis where it belongs, or the error names what happened and the axis is at rest afterwards.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

import pytest
from support.modbus_in_turn import in_turn

from drivers.errors import AbortError, BridgeError, LinkLostError, NoAnswerError, ProtocolError, UndoError
from drivers.limits import DriveLimits
from drivers.modbus.drive import ModbusDrive
from drivers.modbus.endpoint import RtuEndpoint, TcpEndpoint
from drivers.modbus.link import LinkPolicy, ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.scaling import AxisScaling
from sim_backends.bare_shaft import BareShaft
from sim_backends.clock import SimClock
from sim_backends.faults import WireFaultKind
from sim_backends.modbus_cia402 import Cia402Registers
from sim_backends.modbus_drive import ModbusServer, tcp_server
from sim_backends.modbus_faults import WireFault
from sim_backends.modbus_vendor import VendorRegisters
from sim_backends.servo import ServoParameters, SimulatedServo

COUNTS = 100_000
LIMITS = DriveLimits(-3.0, 60.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
TIMEOUT_S = 5.0  # real; no request to a socket is left unanswered, but for one whose connection ends
UNIT = 1
TCP_ONLY = (WireFaultKind.DROP, WireFaultKind.DROP_REQUEST)
KINDS = tuple(WireFaultKind)
TRIGGER_ADDRESS = b"\x06\x00\x06"  # function 6, register 40007 of the vendor's drive
WRITES = (5, 6, 15, 16)


@dataclass
class Rig:
    drive: ModbusDrive
    server: ModbusServer
    servo: SimulatedServo
    clock: SimClock
    farthest_mm: list[float]

    def job(self) -> None:
        drive = self.drive
        drive.open()
        try:
            drive.enable()
            for target in (30.0, 4.0):
                drive.start_move(target, 100.0)
                drive.wait_for(lambda sample: sample.target_reached, 10.0, "arrived", poll_s=0.05)
            drive.disable()
        except BridgeError:
            with suppress(BridgeError):
                drive.quick_stop()
            raise
        finally:
            drive.close()


@contextmanager
def rig(shape: str, wire: str, *, sockets: bool) -> Iterator[Rig]:
    clock = SimClock()
    servo = SimulatedServo(BareShaft(), ServoParameters(counts_per_rev=COUNTS, seed=3))
    seen = [0.0]

    def watch(_now_ns: int, _dt_s: float) -> None:
        seen.append(servo.position_actual_counts / COUNTS * 10.0)

    clock.attach(servo.advance, bearable=servo.bearable)
    clock.attach(watch, bearable=lambda _now_ns: 10_000_000)
    face: Cia402Registers | VendorRegisters
    if shape == "vendor_style":
        face = VendorRegisters(servo, counts_per_rev=COUNTS)
    else:
        face = Cia402Registers(servo, parameters={(0x6085, 0): 20_000_000})
    faces = {UNIT: face}
    with tcp_server(faces, clock) if sockets else in_turn(faces, clock) as (server, place):
        port, make_wire = (place, None) if isinstance(place, int) else (0, place)
        endpoint = (
            RtuEndpoint("in turn", 115_200, "N", timeout_s=TIMEOUT_S)
            if wire == "rtu"
            else TcpEndpoint("127.0.0.1", port, TIMEOUT_S)
        )
        link = ModbusLink(endpoint, clock, policy=LinkPolicy(quiet_s=0.02), make_wire=make_wire)
        drive = ModbusDrive(
            "X", AxisScaling(COUNTS, 10.0), LIMITS, clock, link=link, unit=UNIT, drive_map=load_drive_map(shape)
        )
        yield Rig(drive, server, servo, clock, seen)


@pytest.fixture(scope="module")
def job_length() -> dict[tuple[str, str], int]:
    """Requests of a job without faults."""
    lengths = {}
    for shape in ("cia402_over_modbus", "vendor_style"):
        for wire in ("tcp", "rtu"):
            with rig(shape, wire, sockets=False) as r:
                r.job()
                lengths[shape, wire] = r.server.requests
    return lengths


def _random_fault(kind: WireFaultKind, seed: int, requests: int) -> WireFault:
    chance = random.Random(f"{kind.value} {seed}")
    fault = WireFault(kind, nth=chance.randint(1, requests), delay_s=chance.choice([0.001, 0.01, 0.1]))
    if seed % 4 == 3:
        return replace(fault, count=10**6)  # and from then on
    return replace(fault, count=2) if seed % 4 == 2 else fault


def _run(shape: str, wire: str, kind: WireFaultKind, seed: int, requests: int) -> None:
    fault = _random_fault(kind, seed, requests)
    with rig(shape, wire, sockets=kind in TCP_ONLY) as r:
        r.server.faults.add(fault)
        error: BridgeError | None = None
        try:
            r.job()
        except BridgeError as caught:
            error = caught
        r.clock.sleep_s(3.0)
        assert r.servo.velocity_actual_counts_s == 0
        assert LIMITS.travel_min_mm <= min(r.farthest_mm)
        assert max(r.farthest_mm) <= LIMITS.travel_max_mm
        assert sum(pdu[:3] == TRIGGER_ADDRESS for _, pdu in r.server.seen) <= 2  # one for each move, never more
        if error is None:
            assert r.servo.position_actual_counts == pytest.approx(4.0 / 10.0 * COUNTS, abs=5)
            assert not r.servo.powered or fault.count > 1
            return
        hit = r.server.seen[fault.nth - 1][1]
        _check_error(error, fault, hit)


def _check_error(error: BridgeError, fault: WireFault, hit: bytes) -> None:
    """A fault that hits once must not end a job, unless it is a refusal, hits a start that then nobody can be sure of, or loses the
    request of a write: a write is sent once only."""
    if isinstance(error, UndoError):  # closing the drive met the fault as well: each step is told, the first here
        assert fault.count != 1, f"a fault that hits once spoiled several steps: {error}"
        error = error.errors[0]
    if fault.kind is WireFaultKind.EXCEPTION:
        assert isinstance(error, AbortError)
        assert error.code == 4
        assert "device failure" in str(error)
        return
    assert isinstance(error, NoAnswerError | LinkLostError | ProtocolError)
    if fault.count == 1 and fault.kind in (WireFaultKind.LOST_REQUEST, WireFaultKind.DROP_REQUEST):
        assert hit[0] in WRITES, f"{fault} ended the job: {error}"
        assert "not sent again" in str(error) or "in doubt" in str(error)
    elif fault.count == 1:
        assert hit[:3] == TRIGGER_ADDRESS, f"{fault} ended the job: {error}"
        assert "in doubt" in str(error)


def _cases(seeds: range) -> list[pytest.param]:  # type: ignore[valid-type]
    return [
        pytest.param(shape, wire, kind, seed, id=f"{shape.split('_')[0]}-{wire}-{kind.value.replace(' ', '-')}-{seed}")
        for shape in ("cia402_over_modbus", "vendor_style")
        for wire in ("tcp", "rtu")
        for kind in KINDS
        for seed in seeds
        if not (wire == "rtu" and kind in TCP_ONLY)
    ]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """The places of the faults: as many of each kind as `--seeds` asks for."""
    if "seed" in metafunc.fixturenames:
        seeds = range(metafunc.config.getoption("--seeds"))
        metafunc.parametrize(("shape", "wire", "kind", "seed"), _cases(seeds))


def test_a_fault_somewhere_in_a_job(
    shape: str, wire: str, kind: WireFaultKind, seed: int, job_length: dict[tuple[str, str], int]
) -> None:
    _run(shape, wire, kind, seed, job_length[shape, wire])
