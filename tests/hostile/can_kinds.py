"""Kinds of misbehaving CANopen node and of a second master, as data: the function that begins each, and the errors that may follow.

A verb that meets one ends by one of the errors named, or, where `passes`, completes with correct results. `legit_s`: the time that
a sound drive may take for the same action, which does not count as late: homing over the whole travel takes its time.
"""

from __future__ import annotations

from collections.abc import Callable

from hostile.can_peer import EMCY, HEARTBEAT, RPDO1, RPDOS, SDO_ANSWER, SDO_REQUEST, SYNC, TPDOS, CanPeer
from hostile.peer import Kinds

from drivers.cia402.modes import Mode
from drivers.errors import (
    AbortError,
    CapabilityError,
    DriveFaultError,
    HeldUnderPowerError,
    LinkLostError,
    MeasurementLostError,
    MotionTimeoutError,
    NoAnswerError,
    ProtocolError,
    SafetyError,
    StateError,
)
from hil.backlash.neutral_settings import NotRestoredError
from hil.desk.stop import StoppedByOperator
from sim_backends.faults import CanFaultKind

# settings that nobody takes back from us are named with the file that `--restore` puts back
WIRE = (NoAnswerError, LinkLostError, ProtocolError, NotRestoredError)
REFUSED = (AbortError, ProtocolError)
STATE = (DriveFaultError, StateError, LinkLostError, ProtocolError)
MOTION = (SafetyError, ProtocolError, DriveFaultError, StateError)
OPERATOR = (StoppedByOperator,)
CAN_KINDS = kinds = Kinds()


def _mux(request: bytes) -> bytes:
    return request[1:4]


# -- SDO -----------------------------------------------------------------------------------------------------------------
@kinds("SDO is silent, PDO is alive", *WIRE)
def _(peer: CanPeer) -> None:
    peer.answers(lambda _data: [], SDO_ANSWER)


@kinds("SDO requests are lost", *WIRE)
def _(peer: CanPeer) -> None:
    peer.requests(lambda _data: [], SDO_REQUEST)


@kinds("SDO answers name another index", *WIRE)
def _(peer: CanPeer) -> None:
    peer.answers(
        lambda data: [(0.0, SDO_ANSWER + peer.node_id, data[:1] + bytes((data[1] ^ 1,)) + data[2:])], SDO_ANSWER
    )


@kinds("SDO answers come 2 s late", *WIRE, *MOTION)
def _(peer: CanPeer) -> None:
    peer.answers(lambda data: [(2.0, SDO_ANSWER + peer.node_id, data)], SDO_ANSWER)


@kinds("SDO answers come 40 ms late", *WIRE, *MOTION, passes=True)
def _(peer: CanPeer) -> None:
    peer.answers(lambda data: [(0.04, SDO_ANSWER + peer.node_id, data)], SDO_ANSWER)


@kinds("SDO answers come twice, the second late", *WIRE, *MOTION, passes=True)
def _(peer: CanPeer) -> None:
    cob = SDO_ANSWER + peer.node_id
    peer.answers(lambda data: [(0.0, cob, data), (0.02, cob, data)], SDO_ANSWER)


def _segments(peer: CanPeer, announced: int | None, segment: Callable[[int, int], tuple[bytes, int]]) -> None:
    """Every upload becomes segmented. segment(number, toggle): the data of a segment and the rest of its first byte."""
    number = [0]

    def server(request: bytes) -> list[bytes] | None:
        if request[0] >> 5 == 2:
            number[0] = 0
            size = b"\0\0\0\0" if announced is None else announced.to_bytes(4, "little")
            return [bytes((0x40 if announced is None else 0x41,)) + _mux(request) + size]
        if request[0] >> 5 == 3:
            data, head = segment(number[0], request[0] & 0x10)
            number[0] += 1
            return [bytes((head | (7 - len(data)) << 1,)) + data.ljust(7, b"\0")]
        return None

    peer.serve_sdo(server)


@kinds("SDO segments never end", *WIRE, *REFUSED)
def _(peer: CanPeer) -> None:
    _segments(peer, None, lambda _number, toggle: (bytes(7), toggle))


@kinds("SDO segments are empty and never end", *WIRE, *REFUSED)
def _(peer: CanPeer) -> None:
    _segments(peer, 8, lambda _number, toggle: (b"", toggle))


@kinds("SDO announces 4 GB", *WIRE, *REFUSED)
def _(peer: CanPeer) -> None:
    _segments(peer, 0xFFFFFFFF, lambda _number, toggle: (bytes(7), toggle))


@kinds("SDO announces less than comes", *WIRE, *REFUSED)
def _(peer: CanPeer) -> None:
    _segments(peer, 2, lambda number, toggle: (bytes(7), toggle | (number == 3)))


@kinds("SDO announces more than comes", *WIRE, *REFUSED)
def _(peer: CanPeer) -> None:
    _segments(peer, 400, lambda number, toggle: (bytes(2), toggle | (number == 1)))


@kinds("SDO toggle bit stays", *WIRE, *REFUSED)
def _(peer: CanPeer) -> None:
    _segments(peer, 70, lambda number, _toggle: (bytes((number & 0xFF,)) * 7, 0))


@kinds("SDO answers carry an impossible command", *WIRE)
def _(peer: CanPeer) -> None:
    peer.answers(lambda data: [(0.0, SDO_ANSWER + peer.node_id, b"\xe0" + data[1:])], SDO_ANSWER)


@kinds("SDO answers are cut short", *WIRE)
def _(peer: CanPeer) -> None:
    peer.answers(lambda data: [(0.0, SDO_ANSWER + peer.node_id, data[:5])], SDO_ANSWER)


@kinds("SDO answers are random", *WIRE, *REFUSED)
def _(peer: CanPeer) -> None:
    peer.answers(
        lambda data: [(0.0, SDO_ANSWER + peer.node_id, peer.random.randbytes(1) + data[1:4] + bytes(4))], SDO_ANSWER
    )


# CapabilityError: an object that is refused whatever is asked of it is one that the drive does not show; the refusal is named
@kinds("SDO refuses everything", *REFUSED, StateError, CapabilityError, NotRestoredError)
def _(peer: CanPeer) -> None:
    peer.serve_sdo(lambda data: [b"\x80" + _mux(data) + (0x08000022).to_bytes(4, "little")])


@kinds("SDO refuses every write", *REFUSED, StateError, NotRestoredError)
def _(peer: CanPeer) -> None:
    refusal = (0x08000022).to_bytes(4, "little")
    peer.serve_sdo(lambda data: [b"\x80" + _mux(data) + refusal] if data[0] >> 5 == 1 else None)


@kinds("SDO block is never acknowledged, segments neither", *WIRE, *REFUSED)
def _(peer: CanPeer) -> None:
    def server(request: bytes) -> list[bytes] | None:
        if request[0] >> 5 == 6 and not request[0] & 1:
            return [b"\xa4" + _mux(request) + bytes((127, 0, 0, 0))]
        if request[0] >> 5 == 1 and not request[0] & 2:
            return [b"\x60" + _mux(request) + bytes(4)]
        return None if request[0] >> 5 == 2 else []

    peer.serve_sdo(server)


@kinds("one SDO answer lost, and a second tool reads the node", *WIRE, *MOTION, passes=True)
def _(peer: CanPeer) -> None:
    left = [1]

    def lose(data: bytes) -> list[tuple[float, int, bytes]]:
        if left[0] and data[1:3] != b"\x18\x10":
            left[0] -= 1
            return []
        return [(0.0, SDO_ANSWER + peer.node_id, data)]

    peer.answers(lose, SDO_ANSWER)
    peer.every(0.1, lambda: peer.own(SDO_ANSWER, b"\x43\x18\x10\x01\x78\x56\x34\x12"))


@kinds("a second master reads over the same channel", *WIRE, *MOTION, passes=True)
def _(peer: CanPeer) -> None:
    peer.every(0.007, lambda: peer.speak(SDO_REQUEST + peer.node_id, b"\x40\x18\x10\x01\0\0\0\0"))


@kinds("a second master reads the same objects with other results", *WIRE, *MOTION, passes=True)
def _(peer: CanPeer) -> None:
    peer.every(0.011, lambda: peer.own(SDO_ANSWER, b"\x4b\x41\x60\x00\x37\x16\0\0"))


# -- the node ------------------------------------------------------------------------------------------------------------
@kinds("the heartbeat stops", LinkLostError)
def _(peer: CanPeer) -> None:
    peer.answers(lambda _data: [], HEARTBEAT)


@kinds("the node reboots", *WIRE, *STATE, coasts=True)
def _(peer: CanPeer) -> None:
    peer.strike()
    peer.slave.boot(peer.clock.now_ns())


@kinds("the node announces a reboot every ms", *WIRE, *STATE)
def _(peer: CanPeer) -> None:
    peer.every(0.001, lambda: peer.own(HEARTBEAT, b"\0"))


# AbortError: the second answer to a segment is taken for that to the next one, and the drive refuses what then comes out of turn
@kinds("another node has the same id", *WIRE, *STATE, *MOTION, AbortError, passes=True)
def _(peer: CanPeer) -> None:
    cobs = {function: function + peer.node_id for function in (SDO_ANSWER, TPDOS[0])}
    other = b"\x50\x02" + bytes(6)  # switch on disabled, at 0
    peer.answers(
        lambda data: [(0.0, cobs[SDO_ANSWER], data), (0.0002, cobs[SDO_ANSWER], data[:4] + bytes(4))], SDO_ANSWER
    )
    peer.answers(lambda data: [(0.0, cobs[TPDOS[0]], data), (0.0002, cobs[TPDOS[0]], other[: len(data)])], TPDOS[0])


@kinds("the node is cut off", *WIRE, unreachable=True)
def _(peer: CanPeer) -> None:
    peer.strike()
    peer.answers(lambda _data: [], *TPDOS, SDO_ANSWER, HEARTBEAT, EMCY)
    peer.requests(lambda _data: [], SDO_REQUEST, *RPDOS)
    peer._to_rules.append(lambda _cob, _data: [])


@kinds("bus-off for good", *WIRE, unreachable=True)
def _(peer: CanPeer) -> None:
    peer.strike()
    peer.bus.ports[0].schedule_bus_off(peer.clock.now_ns() * 1e-9, 1e6)


@kinds("bus-off for 1 s", *WIRE, *STATE, unreachable=True)
def _(peer: CanPeer) -> None:
    peer.strike()
    peer.bus.ports[0].schedule_bus_off(peer.clock.now_ns() * 1e-9, 1.0)


@kinds("another master stops the node (NMT)", *WIRE, *STATE)
def _(peer: CanPeer) -> None:
    peer.speak(0, bytes((0x02, peer.node_id)))


@kinds("another master takes the node out of operation (NMT)", *WIRE, *STATE)
def _(peer: CanPeer) -> None:
    peer.speak(0, bytes((0x80, peer.node_id)))


@kinds("the supply fails for 2 s", *WIRE, *STATE, coasts=True)
def _(peer: CanPeer) -> None:
    peer.strike()
    now_ns = peer.clock.now_ns()
    peer.slave.lose_power(now_ns)
    back: list[int] = []
    peer._from_rules.append(lambda _cob, _data: None if back else [])
    peer._to_rules.append(lambda _cob, _data: None if back else [])

    def boot() -> None:
        back.append(1)
        peer.slave.boot(peer.clock.now_ns())

    peer.after(2.0, boot)


@kinds("heartbeats flood", *WIRE, passes=True)
def _(peer: CanPeer) -> None:
    peer.every(0.0005, lambda: peer.own(HEARTBEAT, b"\x05"))


@kinds("emergencies flood", *WIRE, *STATE, passes=True)
def _(peer: CanPeer) -> None:
    peer.every(0.001, lambda: peer.own(EMCY, b"\x01\xff\x01" + bytes(5)))


@kinds("frames of strangers flood", *WIRE, passes=True)
def _(peer: CanPeer) -> None:
    peer.every(0.0007, lambda: peer.speak(0x700 + peer.random.randrange(20, 127), peer.random.randbytes(1)))


@kinds("every frame of the drive comes twice", *WIRE, passes=True)
def _(peer: CanPeer) -> None:
    peer._from_rules.append(lambda cob, data: [(0.0, cob, data)] * 2)


# -- PDO and SYNC ----------------------------------------------------------------------------------------------------------
@kinds("PDO is dead, SDO is alive", *WIRE)
def _(peer: CanPeer) -> None:
    peer.answers(lambda _data: [], *TPDOS)
    peer.requests(lambda _data: [], *RPDOS)


@kinds("TPDOs come 0.3 s late", *WIRE, *MOTION)
def _(peer: CanPeer) -> None:
    for function in TPDOS:
        peer.answers(lambda data, cob=function + peer.node_id: [(0.3, cob, data)], function)


@kinds("TPDOs are short", *WIRE, *MOTION)
def _(peer: CanPeer) -> None:
    for function in TPDOS:
        peer.answers(lambda data, cob=function + peer.node_id: [(0.0, cob, data[:-1])], function)


@kinds("TPDOs are long", *WIRE, passes=True)
def _(peer: CanPeer) -> None:
    for function in TPDOS:
        peer.answers(lambda data, cob=function + peer.node_id: [(0.0, cob, data.ljust(8, b"\xff"))], function)


@kinds("TPDOs are frozen", *WIRE, *MOTION)
def _(peer: CanPeer) -> None:
    last: dict[int, bytes] = {}
    for function in TPDOS:
        cob = function + peer.node_id
        peer.answers(lambda data, cob=cob: [(0.0, cob, last.setdefault(cob, data))], function)


@kinds("RPDOs are lost", *WIRE, *MOTION, passes=True)
def _(peer: CanPeer) -> None:
    peer.requests(lambda _data: [], *RPDOS)


@kinds("a second master sends SYNC", *WIRE, *MOTION, passes=True)
def _(peer: CanPeer) -> None:
    peer.every(0.003, lambda: peer.speak(SYNC, b""))


# -- values that the drive shows -------------------------------------------------------------------------------------------
def _frozen(peer: CanPeer, *indices: int) -> None:
    for index in indices:
        kept: list[int] = []

        def first(value: int, kept: list[int] = kept) -> int:
            kept.append(value)
            return kept[0]

        peer.shows(index, first)


@kinds("statusword frozen", *WIRE, *MOTION)
def _(peer: CanPeer) -> None:
    _frozen(peer, 0x6041)


@kinds("position frozen", *MOTION, MeasurementLostError)
def _(peer: CanPeer) -> None:
    _frozen(peer, 0x6064)


@kinds("position jumps by a motor revolution", *MOTION, MeasurementLostError)
def _(peer: CanPeer) -> None:
    peer.shows(0x6064, lambda counts: counts + 1_000_000)


@kinds("position has the other sign", *MOTION, MeasurementLostError)
def _(peer: CanPeer) -> None:
    peer.shows(0x6064, lambda counts: -counts)


@kinds("enabled, it says, and is disabled", *STATE, *MOTION, coasts=True)
def _(peer: CanPeer) -> None:
    peer.strike()
    peer.servo.power_off()
    peer.instead("power_on", lambda: None)
    peer.shows(0x6041, lambda status: status & ~0x6F | 0x27)


@kinds("statusword that the standard does not have", *STATE, *MOTION)
def _(peer: CanPeer) -> None:
    peer.defect(CanFaultKind.STATUS_IMPOSSIBLE)


@kinds("the set-point is never acknowledged", ProtocolError, MotionTimeoutError)
def _(peer: CanPeer) -> None:
    peer.slave.profile.defects.add(CanFaultKind.SETPOINT_NOT_TAKEN)

    def given(request: bytes) -> None:  # a stream hands over none, and a run may have none left to hand over
        if request[0] >> 5 == 1 and request[1:3] == b"\x40\x60" and request[4] & 0x10:
            peer.strike()

    peer.requests(given, SDO_REQUEST)


@kinds("the acknowledge bit stays", ProtocolError, MotionTimeoutError, StateError, passes=True)
def _(peer: CanPeer) -> None:
    peer.defect(CanFaultKind.ACKNOWLEDGE_STUCK)


# a documented drive does so; arrival is then told by the positions
@kinds("target reached is always shown", *MOTION, passes=True)
def _(peer: CanPeer) -> None:
    peer.shows(0x6041, lambda status: status | 0x0400)


@kinds("target reached is never shown", *MOTION)
def _(peer: CanPeer) -> None:
    peer.slave.profile.defects.add(CanFaultKind.NEVER_ARRIVES)

    def look() -> None:  # no arrival is waited for in a stream, nor of an axis that stands while another moves
        if peer.slave.dictionary.number(0x6060) != Mode.CYCLIC_POSITION and peer.servo.velocity_actual_counts_s:
            peer.strike()

    peer.every(0.002, look)


@kinds("the mode display is stuck", *MOTION, passes=True)
def _(peer: CanPeer) -> None:
    peer.defect(CanFaultKind.MODE_STUCK)


@kinds("homing is attained at once", *MOTION, MeasurementLostError, at_start=True, passes=True)
def _(peer: CanPeer) -> None:
    peer.instead("start_homing", lambda *_: setattr(peer.servo, "homed", True))
    peer.shows(0x6041, lambda status: status | 0x1400 if peer.slave.dictionary.number(0x6060) == 6 else status)


@kinds("homing never ends", *MOTION, at_start=True)
def _(peer: CanPeer) -> None:
    peer.instead("start_homing", lambda *_: None)


@kinds("standstill is never shown", *OPERATOR, HeldUnderPowerError, stop_after_s=0.3)
def _(peer: CanPeer) -> None:
    peer.strike()
    peer.shows(0x606C, lambda counts_s: counts_s + 40_000 + peer.random.randrange(1000))
    peer.shows(0x6064, lambda counts: counts + peer.random.randrange(-400, 400))
    peer.shows(0x6041, lambda status: status & ~0x0400)


# -- behaviour of the drive --------------------------------------------------------------------------------------------------
@kinds("safe torque off", *STATE, *MOTION, coasts=True)
def _(peer: CanPeer) -> None:
    peer.defect(CanFaultKind.SAFE_TORQUE_OFF)


def _when_powered(peer: CanPeer, act: Callable[[], None]) -> None:
    if peer.servo.powered:
        peer.strike()
        act()
    else:
        peer.after(0.02, lambda: _when_powered(peer, act))


@kinds("it disables itself", *STATE, *MOTION, coasts=True)
def _(peer: CanPeer) -> None:
    _when_powered(peer, lambda: peer.slave.profile._write_controlword(0x0000))


@kinds("it takes no controlword (local control)", *STATE, *MOTION)
def _(peer: CanPeer) -> None:
    peer.defect(CanFaultKind.LOCAL_CONTROL)


@kinds("a second master disables it", *STATE, *MOTION, coasts=True)
def _(peer: CanPeer) -> None:
    _when_powered(peer, lambda: peer.speak(SDO_REQUEST + peer.node_id, b"\x2b\x40\x60\x00\x06\0\0\0"))


@kinds("a second master moves it", *STATE, *MOTION, MeasurementLostError, disobeys_mm=60.0)
def _(peer: CanPeer) -> None:
    def move() -> None:
        target = (peer.servo.position_actual_counts + 5_000_000).to_bytes(4, "little", signed=True)
        for word in (0x0F, 0x3F):
            peer.speak(RPDO1 + peer.node_id, word.to_bytes(2, "little") + target)
            peer.speak(SYNC, b"")

    peer.every(0.05, move)


@kinds("the operator stops while SDO is silent", *OPERATOR, *WIRE, stop_after_s=0.05)
def _(peer: CanPeer) -> None:
    peer.strike()
    peer.answers(lambda _data: [], SDO_ANSWER)


@kinds("the operator stops while PDO is dead", *OPERATOR, *WIRE, stop_after_s=0.05)
def _(peer: CanPeer) -> None:
    peer.strike()
    peer.answers(lambda _data: [], *TPDOS)
    peer.requests(lambda _data: [], *RPDOS)
