"""SYNC has one owner per bus: who sends it when several drives, links and programs share the wire, and how a stream is left."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise, takewhile
from typing import Any

import can
import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive
from drivers.canopen.stream import FOREIGN_SYNCS, CyclicStream
from drivers.canopen.sync import LISTEN_S, SYNC_SILENCE_S
from drivers.cia402 import objects
from drivers.cia402.modes import Mode
from drivers.drive import DriveState
from drivers.errors import BridgeError, InputError, SafetyError, StateError, UndoError
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings
from sim_backends.canopen_dictionary import RefusedError

LIMITS = DriveLimits(-300.0, 300.0, max_velocity_mm_s=200.0, max_acceleration_mm_s2=2000.0)
X, Y = 5, 6


class Bus:
    """Two drives on one wire; `link()` is another program on it. syncs: when SYNC was sent; tpdos: how often a node's came."""

    def __init__(self, **bench: Any) -> None:
        self.bench = CanBench((X, Y), **bench)
        self.clock = self.bench.clock
        self.syncs: list[int] = []
        self.tpdos: Counter[int] = Counter()
        self.orders: list[tuple[int, int]] = []  # node and object of each write, and of each stop by RPDO
        self.bench.wire.add_node().on_frame = self._see

    def _see(self, cob_id: int, data: bytes, now_ns: int) -> None:
        if cob_id == 0x080:
            self.syncs.append(now_ns)
        elif cob_id & 0x780 in (0x180, 0x280) and cob_id & 0x7F in (X, Y):
            self.tpdos[cob_id & 0x7F] += 1
        elif cob_id & 0x780 == 0x300:
            self.orders.append((cob_id & 0x7F, 0x6040))
        elif cob_id & 0x780 == 0x600 and data[0] >> 5 == 1:
            self.orders.append((cob_id & 0x7F, int.from_bytes(data[1:3], "little")))

    def link(self) -> CanLink:
        return CanLink(self.bench.port(), self.clock)

    def drive(self, node_id: int, link: CanLink) -> CanOpenDrive:
        drive = CanOpenDrive(
            {X: "X", Y: "Y"}[node_id], AxisScaling(100_000, 10.0), LIMITS, self.clock, link=link, node_id=node_id
        )
        drive.open()
        return drive

    def gaps_ms(self, since: int) -> set[float]:
        """Between the SYNCs after the first so many."""
        return {(after - before) / 1e6 for before, after in pairwise(self.syncs[since:])}

    def syncs_of(self, look: Callable[[], object]) -> int:
        before = len(self.syncs)
        look()
        return len(self.syncs) - before


@pytest.fixture
def bus() -> Bus:
    return Bus()


@pytest.fixture
def pair(bus: Bus) -> Iterator[tuple[CanOpenDrive, CanOpenDrive]]:
    """Both enabled, on one link."""
    link = bus.link()
    drives = bus.drive(X, link), bus.drive(Y, link)
    for drive in drives:
        drive.enable()
    yield drives
    link.close()


# -- looking beside a stream -----------------------------------------------------------------------------------------------


def test_a_look_at_a_neighbour_on_the_same_link_sends_nothing_into_a_stream(
    bus: Bus, pair: tuple[CanOpenDrive, CanOpenDrive]
) -> None:
    x, y = pair
    with CyclicStream([x], SetPointSettings(0.01)) as stream:
        start = len(bus.syncs)
        bus.tpdos.clear()
        for cycle in range(40):
            if cycle in (10, 13):
                bus.clock.sleep_s(0.004)
                assert y.sample().state is DriveState.ENABLED
            stream.cycle([0.5 * cycle])
    assert bus.gaps_ms(start) == {10.0}
    assert (bus.tpdos[X], bus.tpdos[Y]) == (40, 0)
    assert bus.syncs_of(y.sample) == 1  # and afterwards looks go by SYNC again
    assert bus.tpdos[Y] == 2


def test_a_neighbour_moves_and_is_watched_while_the_other_streams(pair: tuple[CanOpenDrive, CanOpenDrive]) -> None:
    x, y = pair
    y.start_move(5.0, 100.0)
    with CyclicStream([x], SetPointSettings(0.01)) as stream:
        for cycle in range(60):
            stream.cycle([0.5 * cycle])
            y.sample()
        assert y.sample().target_reached
    assert y.sample().position_load_mm == pytest.approx(5.0, abs=1e-3)


@pytest.mark.parametrize("period_s", [0.01, 0.0005])
def test_a_neighbour_whose_tpdos_cannot_be_switched_off_counts_in_the_load(period_s: float) -> None:
    """1 Mbit/s: X alone takes 285 µs, with both TPDOs of Y 540 µs."""
    bus = Bus()
    link = bus.link()
    drives = bus.drive(X, link), bus.drive(Y, link)
    bus.bench.slaves[Y].dictionary.lock(0x1800, 1)
    drives[0].enable()
    stream = CyclicStream([drives[0]], SetPointSettings(period_s))
    if period_s < 0.001:
        with pytest.raises(InputError, match="SYNC and PDOs need"), stream:
            pytest.fail("entered")
        assert drives[0].sample().state is DriveState.ENABLED
        assert drives[0].modes.mode is Mode.PROFILE_POSITION
        return
    with stream:
        stream.cycle([0.0])
        drives[1].sample()


def test_a_look_from_another_program_sends_nothing_into_a_stream(bus: Bus) -> None:
    x, y = bus.drive(X, bus.link()), bus.drive(Y, bus.link())
    x.enable()
    with CyclicStream([x], SetPointSettings(0.004)) as stream:
        start = len(bus.syncs)
        bus.tpdos.clear()
        for cycle in range(250):
            stream.cycle([0.02 * cycle])
            if cycle % 12 == 0:
                bus.clock.sleep_s(0.0013)
                y.sample()
        assert stream.foreign_syncs == 0
    assert bus.gaps_ms(start) == {4.0}
    assert bus.tpdos[Y] <= 2  # to the first SYNC, which nobody announced


def test_a_program_that_is_started_during_a_stream_listens_before_it_sends(bus: Bus) -> None:
    _foreign_syncs(bus, 10_000, 0.02)
    start = len(bus.syncs)
    y = bus.drive(Y, bus.link())
    for _ in range(20):
        y.sample()
        bus.clock.sleep_s(0.013)
    assert bus.gaps_ms(start) == {20.0}
    assert bus.tpdos[Y] == 0
    assert LISTEN_S > 0.02


# -- looking beside looking ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first", [X, Y])
def test_two_programs_that_only_look_converge_on_one_owner(bus: Bus, first: int) -> None:
    drives = {node_id: bus.drive(node_id, bus.link()) for node_id in (first, X + Y - first)}
    senders: list[int] = []
    for _ in range(200):  # 10 s
        for node_id, drive in drives.items():
            senders += [node_id] * bus.syncs_of(drive.sample)
            bus.clock.sleep_s(0.025)
    assert set(senders[-100:]) == {senders[-1]}
    assert len(senders) >= 150  # somebody does: SDO for everybody is what is to be avoided
    changes = sum(before != after for before, after in pairwise(senders))
    assert changes <= 1


def test_sync_is_taken_up_again_after_a_silence(bus: Bus) -> None:
    links = bus.link(), bus.link()
    x, y = bus.drive(X, links[0]), bus.drive(Y, links[1])
    assert (bus.syncs_of(x.sample), bus.syncs_of(y.sample)) == (1, 0)
    x.close()
    y.sample()  # hears the last of X's
    bus.clock.sleep_s(SYNC_SILENCE_S - 0.05)
    assert bus.syncs_of(y.sample) == 0
    bus.clock.sleep_s(0.3)
    assert bus.syncs_of(y.sample) == 1
    before = bus.tpdos[Y]
    y.sample()
    assert bus.tpdos[Y] == before + 2


def test_one_that_looks_leaves_sync_to_a_stream_that_begins(bus: Bus) -> None:
    """Y's program owned SYNC; X's stream claims it."""
    links = bus.link(), bus.link()
    y, x = bus.drive(Y, links[0]), bus.drive(X, links[1])
    assert (bus.syncs_of(y.sample), bus.syncs_of(x.sample)) == (1, 0)
    x.enable()
    with CyclicStream([x], SetPointSettings(0.004)) as stream:
        start = len(bus.syncs)
        for cycle in range(100):
            stream.cycle([0.02 * cycle])
            if cycle % 12 == 0:
                y.sample()
        assert stream.foreign_syncs == 0
    assert bus.gaps_ms(start) == {4.0}


# -- a second producer -------------------------------------------------------------------------------------------------------------


def _foreign_syncs(bus: Bus, count: int, period_s: float) -> None:
    """Another master sends SYNC in the bus's own time, from now on."""
    port = bus.bench.port()
    sent = [0]
    message = can.Message(arbitration_id=0x080, data=b"", is_extended_id=False)
    next_ns = [bus.clock.now_ns() + round(0.0007e9)]

    def advance(now_ns: int, _dt_s: float) -> None:
        while sent[0] < count and now_ns >= next_ns[0]:
            next_ns[0] += round(period_s * 1e9)
            sent[0] += 1
            port.send(message)

    bus.clock.attach(advance, bearable=lambda now_ns: max(1, next_ns[0] - now_ns) if sent[0] < count else 1 << 60)


@pytest.mark.parametrize("period_s", [0.004, 0.0131, 1.0])
def test_a_second_producer_ends_the_stream(bus: Bus, period_s: float) -> None:
    x = bus.drive(X, bus.link())
    x.enable()
    stream = CyclicStream([x], SetPointSettings(0.004))

    def run() -> None:
        with stream:
            _foreign_syncs(bus, 10_000, period_s)
            for _ in range(2500):
                stream.cycle([0.0])

    with pytest.raises(SafetyError, match="a second SYNC producer is on the bus"):
        run()
    assert stream.foreign_syncs == FOREIGN_SYNCS + 1
    assert bus.bench.slaves[X].profile.state is not DriveState.ENABLED


def test_a_few_foreign_syncs_are_counted_and_lived_with(bus: Bus) -> None:
    x = bus.drive(X, bus.link())
    x.enable()
    with CyclicStream([x], SetPointSettings(0.004)) as stream:
        _foreign_syncs(bus, FOREIGN_SYNCS, 0.05)
        for _ in range(100):
            stream.cycle([0.0])
    assert stream.foreign_syncs == FOREIGN_SYNCS
    assert x.sample().state is DriveState.ENABLED


def test_a_stream_does_not_begin_beside_another_programs(bus: Bus) -> None:
    y = bus.drive(Y, bus.link())
    y.enable()
    _foreign_syncs(bus, 10_000, 0.02)
    bus.clock.sleep_s(0.03)
    with (
        pytest.raises(StateError, match="another program streams on this bus"),
        CyclicStream([y], SetPointSettings(0.01)),
    ):
        pytest.fail("entered")
    assert y.sample().state is DriveState.ENABLED
    assert y.modes.mode is Mode.PROFILE_POSITION


# -- leaving a stream ------------------------------------------------------------------------------------------------------------


def _raising(bus: Bus, node_id: int, key: tuple[int, int], error: BaseException) -> None:
    """From now on each write of this object of a node ends so."""

    def write(_value: int) -> None:
        raise error

    bus.bench.slaves[node_id].dictionary.on_write(*key, write)


def _told_first(bus: Bus, node_id: int, key: tuple[int, int], act: Callable[[], object]) -> set[int]:
    """The operator interrupts at the first write of this object; the nodes that are told to stop before anything else is written."""
    before: list[int] = []

    def interrupt(_value: int) -> None:
        if not before:
            before.append(len(bus.orders))
            raise KeyboardInterrupt

    bus.bench.slaves[node_id].dictionary.on_write(*key, interrupt)
    with pytest.raises(KeyboardInterrupt):
        act()
    return {node for node, _ in takewhile(lambda order: order[1] == 0x6040, bus.orders[before[0] :])}


SYNC_PERIOD, MODE = (0x1006, 0), (0x6060, 0)


def _streaming(*drives: CanOpenDrive) -> CyclicStream:
    stream = CyclicStream(drives, SetPointSettings(0.01))
    stream.__enter__()
    stream.cycle([0.0] * len(drives))
    return stream


def test_leaving_a_stream_is_done_to_the_end_whatever_fails(bus: Bus, pair: tuple[CanOpenDrive, CanOpenDrive]) -> None:
    stream = _streaming(*pair)
    for node_id in (X, Y):
        _raising(bus, node_id, SYNC_PERIOD, RefusedError(0x08000022))
    with pytest.raises(UndoError, match=r"drive X: 1006h not put back: .*; drive Y: 1006h not put back: ") as caught:
        stream.__exit__(None, None, None)
    assert len(caught.value.errors) == 2
    for drive in pair:
        assert not drive.is_streaming
        assert drive.modes.mode is Mode.PROFILE_POSITION
        assert drive.sample().state is DriveState.ENABLED
        drive.start_move(3.0, 50.0)


BUFFER, TEXT = (0x2100, 0), bytes(range(70))


@pytest.mark.parametrize("error", [None, StateError("ended")], ids=["clean", "stop"])
@pytest.mark.parametrize("data", [b"", TEXT[:4], TEXT], ids=["read", "write", "long write"])
def test_a_transfer_of_another_thread_at_the_end_of_a_stream(
    bus: Bus,
    pair: tuple[CanOpenDrive, CanOpenDrive],
    monkeypatch: pytest.MonkeyPatch,
    data: bytes,
    error: StateError | None,
) -> None:
    """It takes ten periods; without SYNC a drive goes into a fault after five (8700h). A stop breaks it off."""
    stream, (x, _) = _streaming(*pair), pair
    begun, ten_periods, ended = threading.Event(), threading.Event(), threading.Event()
    send, got = x.link.bus.send, list[object]()

    def sending(message: can.Message, timeout: float | None = None) -> None:
        """Simulated time passes in one thread at a time: in the one that leaves the stream until ten SYNCs are sent, then in this."""
        send(message, timeout)
        if threading.current_thread() is accessing and not begun.is_set():
            begun.set()
            if not ten_periods.wait(5.0):
                bus.clock.sleep_s(0.1)
        elif threading.current_thread() is not accessing and len(bus.syncs) >= before + 10:
            ten_periods.set()
            ended.wait(5.0)

    def access() -> None:
        try:
            got.append(x.sdo.write_bytes(*BUFFER, data) if data else x.sdo.read_bytes(*BUFFER))
        except BridgeError as broken_off:
            got.append(broken_off)
        ended.set()

    accessing = threading.Thread(target=access)
    bus.bench.slaves[X].dictionary.set_raw(BUFFER, b"" if data else TEXT)
    before = len(bus.syncs)
    monkeypatch.setattr(x.link.bus, "send", sending)
    accessing.start()
    assert begun.wait(5.0)
    stream.__exit__(error and type(error), error, None)
    accessing.join()
    if error is None:
        assert got == [None if data else TEXT]
        assert bus.bench.slaves[X].dictionary.raw(BUFFER) == (data or TEXT)
    else:
        assert [type(each) for each in got] == [StateError]
        assert "broken off by a stop" in str(got[0])
    for node_id in (X, Y):
        slave = bus.bench.slaves[node_id]
        assert slave.dictionary.number(*SYNC_PERIOD) == 0
        assert slave.dictionary.number(0x1003, 0) == 0
        assert (slave.profile.state is DriveState.ENABLED) is (error is None)


@pytest.mark.parametrize("key", [MODE, (0x1400, 1)], ids=["mode", "PDO"])
def test_an_axis_that_cannot_be_put_back_is_disabled_and_the_others_are_put_back(
    bus: Bus, pair: tuple[CanOpenDrive, CanOpenDrive], key: tuple[int, int]
) -> None:
    x, y = pair
    stream = _streaming(x, y)
    _raising(bus, X, key, RefusedError(0x08000022))
    with pytest.raises(BridgeError, match=f"drive X: .*{key[0]:X}h"):
        stream.__exit__(None, None, None)
    assert not bus.bench.servos[X].powered
    assert not x.is_streaming
    assert y.sample().state is DriveState.ENABLED
    assert y.modes.mode is Mode.PROFILE_POSITION


def test_an_interrupt_on_the_way_out_of_a_stream_does_not_end_it(
    bus: Bus, pair: tuple[CanOpenDrive, CanOpenDrive]
) -> None:
    stream = _streaming(*pair)
    assert _told_first(bus, X, SYNC_PERIOD, lambda: stream.__exit__(None, None, None)) == {X, Y}
    _without_power_or_stream(bus, pair)


def _without_power_or_stream(bus: Bus, pair: tuple[CanOpenDrive, CanOpenDrive]) -> None:
    for node_id, drive in zip((X, Y), pair, strict=True):
        assert bus.bench.slaves[node_id].profile.state is not DriveState.ENABLED
        assert not drive.is_streaming
        assert not drive.link.sync.streaming


@pytest.mark.parametrize("key", [(0x60C2, 1), (0x1600, 0)], ids=["period", "PDO"])
def test_an_interrupt_while_a_stream_is_entered_tells_the_drives_to_stop_before_they_are_put_back(
    bus: Bus, pair: tuple[CanOpenDrive, CanOpenDrive], key: tuple[int, int]
) -> None:
    stream = CyclicStream(pair, SetPointSettings(0.01))
    assert _told_first(bus, Y, key, stream.__enter__) == {X, Y}
    _without_power_or_stream(bus, pair)


def test_a_stream_that_cannot_be_entered_leaves_every_axis_as_it_was(
    bus: Bus, pair: tuple[CanOpenDrive, CanOpenDrive]
) -> None:
    x, y = pair
    y.disable()
    before = {
        key: bus.bench.slaves[X].dictionary.number(*key) for key in ((0x1800, 1), (0x1401, 1), (0x1A00, 0), (0x1006, 0))
    }
    with (
        pytest.raises(StateError, match="drive Y cannot stream: it is switch on disabled"),
        CyclicStream([x, y], SetPointSettings(0.01)),
    ):
        pytest.fail("entered")
    assert x.sample().state is DriveState.ENABLED
    assert x.modes.mode is Mode.PROFILE_POSITION
    assert x.sdo.read(objects.MODE_DISPLAY) == Mode.PROFILE_POSITION
    assert {key: bus.bench.slaves[X].dictionary.number(*key) for key in before} == before
    x.start_move(3.0, 50.0)
    x.wait_for(lambda sample: sample.target_reached, 5.0, "arrived")


def test_what_fails_while_an_error_leads_out_of_a_stream_is_told_with_it(
    bus: Bus, pair: tuple[CanOpenDrive, CanOpenDrive]
) -> None:
    x, y = pair

    def run() -> None:
        with CyclicStream([x, y], SetPointSettings(0.01)) as stream:
            for cycle in range(20):
                stream.cycle([0.5 * cycle, 0.5 * cycle])
            _raising(bus, Y, SYNC_PERIOD, RefusedError(0x08000022))
            x.send_stop()
            stream.cycle([10.0, 10.0])

    with pytest.raises(StateError, match="was told to stop") as caught:
        run()
    assert [note for note in caught.value.__notes__ if note.startswith("drive Y: 1006h")]
    bus.clock.sleep_s(0.5)
    for node_id in (X, Y):
        assert bus.bench.slaves[node_id].profile.state is not DriveState.ENABLED
        assert bus.bench.servos[node_id].velocity_actual_counts_s == 0
    assert not x.link.sync.streaming


def test_what_a_stream_wrote_for_itself_is_put_back_when_the_drive_is_closed(bus: Bus) -> None:
    dictionary = bus.bench.slaves[X].dictionary
    kept = ((0x60C2, 1), (0x60C2, 2), (0x1006, 0), (0x6060, 0))
    before = [dictionary.number(*key) for key in kept]
    x = bus.drive(X, bus.link())
    x.enable()
    with CyclicStream([x], SetPointSettings(0.007)) as stream:
        stream.cycle([0.0])
        assert [dictionary.number(*key) for key in kept] != before
    x.close()
    assert [dictionary.number(*key) for key in kept] == before
