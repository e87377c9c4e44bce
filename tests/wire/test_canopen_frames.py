"""What stands on the wire, frame by frame in candump's notation, written from CiA-301 and CiA-402 and not from the program.

One job on the simulated wire, watched by a third party.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from support.can_bench import CanBench
from support.can_wire import Node

from drivers.canopen.bus import CanLink
from drivers.canopen.drive import CanOpenDrive, CanOpenSettings
from drivers.canopen.node import NmtCommand, NodeMonitor
from drivers.canopen.stream import CyclicStream
from drivers.cia402.modes import Mode
from drivers.limits import DriveLimits
from drivers.scaling import AxisScaling
from drivers.set_points import SetPointSettings

NODE = 5


class Spy:
    """Writes down every frame; `take()` gives those since the last call."""

    def __init__(self, bench: CanBench) -> None:
        self._seen: list[str] = []
        node: Node = bench.wire.add_node()
        node.on_frame = lambda cob_id, data, _now_ns: self._seen.append(f"{cob_id:03X}#{data.hex().upper()}")

    def take(self) -> list[str]:
        seen, self._seen = self._seen, []
        return seen


@contextmanager
def _rig(**settings: object) -> Iterator[tuple[CanBench, CanOpenDrive, Spy]]:
    bench = CanBench((NODE,))
    spy = Spy(bench)
    with CanLink(bench.port(), bench.clock) as link:
        drive = CanOpenDrive(
            "X",
            AxisScaling(100_000, 10.0),
            DriveLimits(-100.0, 100.0, 200.0, 2000.0),
            bench.clock,
            link=link,
            node_id=NODE,
            settings=CanOpenSettings(**settings),  # type: ignore[arg-type]
        )
        yield bench, drive, spy


def test_boot_up_nmt_and_heartbeat() -> None:
    bench = CanBench((NODE,))
    spy = Spy(bench)
    with CanLink(bench.port(), bench.clock) as link:
        monitor = NodeMonitor(link, NODE, "X")
        monitor.command(NmtCommand.RESET_NODE)
        assert monitor.state is None  # what was commanded was not heard
        link.send(0x605, bytes.fromhex("2B17100064000000"))  # heartbeat every 100 ms
        monitor.command(NmtCommand.START)
        bench.clock.sleep_s(0.21)
        monitor.command(NmtCommand.STOP)
        monitor.command(NmtCommand.PRE_OPERATIONAL)
        bench.clock.sleep_s(0.1)
    assert spy.take() == [
        "000#8105",  # reset node 5
        "705#00",  # boot-up
        "605#2B17100064000000",
        "585#6017100000000000",
        "000#0105",  # start
        "185#5006",  # the default TPDOs are event driven: their first event is to become operational
        "285#500600",
        "705#05",  # operational
        "705#05",
        "000#0205",  # stop
        "000#8005",  # enter pre-operational
        "705#7F",
    ]


def test_a_sample_is_a_sync_and_its_tpdos() -> None:
    with _rig(heartbeat_s=None) as (bench, drive, spy), drive:
        bench.servo.power_on()
        spy.take()
        drive.sample()
        assert spy.take() == [
            "080#",
            # 6041h 0250h: switch on disabled, voltage enabled, remote; bit 10: at its target; 6064h 0, 6077h 0
            "185#5006000000000000",
            "285#0000000000000000",  # 606Ch, 60F4h
        ]


def test_enabling_writes_the_target_first() -> None:
    with _rig(heartbeat_s=None) as (_, drive, spy), drive:
        spy.take()
        drive.enable()
        writes = [frame for frame in spy.take() if frame.startswith(("605#2", "605#3"))]
    assert writes == [
        "605#2F60600001000000",  # profile position
        "605#2B40600006000000",  # shutdown
        "605#2B40600007000000",  # switch on
        "605#237A600000000000",  # target position := 6064h
        "605#23FF600000000000",  # target velocity := 0
        "605#2B71600000000000",  # target torque := 0
        "605#2B4060000F000000",  # enable operation
    ]


def test_a_move_is_a_handshake() -> None:
    with _rig(heartbeat_s=None) as (bench, drive, spy), drive:
        drive.enable()
        bench.clock.sleep_s(0.1)
        spy.take()
        drive.start_move(-12.5, 30.0)
        frames = spy.take()
        writes = [frame for frame in frames if frame.startswith(("605#2", "605#3"))]
        statuses = [frame[4:8] for frame in frames if frame.startswith("185#")]
        drive.quick_stop()
        stop = spy.take()
    assert writes == [
        "605#23816000E0930400",  # 6081h: 300 000 counts/s
        "605#23836000002D3101",  # 6083h: 20 000 000 counts/s²
        "605#23846000002D3101",  # 6084h
        "605#237A6000B817FEFF",  # 607Ah: -125 000
        "605#2B4060003F000000",  # new set-point, change immediately
        "605#2B4060000F000000",
    ]
    # 0637h at its target; 1237h acknowledged and under way; 0237h ready for the next
    assert [status for status, before in zip(statuses, ["", *statuses], strict=False) if status != before] == [
        "3706",
        "3712",
        "3702",
    ]
    # the event-driven RPDO 2 maps 6040h alone and takes effect without SYNC; the same by SDO; then the statusword is looked at
    assert stop[:3] == ["305#0200", "605#2B40600002000000", "585#6040600000000000"]
    assert stop[3] == "080#"
    assert stop[4].startswith("185#")
    assert int(stop[4][6:8] + stop[4][4:6], 16) & 0x6F == 0x07  # quick stop active


def test_a_fault_an_emergency_and_its_reset() -> None:
    with _rig(heartbeat_s=None) as (bench, drive, spy), drive:
        drive.enable()
        spy.take()
        bench.servo.raise_fault(0x8611)
        bench.clock.sleep_s(0.05)
        assert spy.take() == ["085#1186210000000000"]  # following error; register: generic, profile specific
        drive.reset_fault()
        frames = spy.take()
    assert [frame for frame in frames if frame.startswith("605#2")] == [
        "605#2B40600000000000",
        "605#2B40600080000000",
        "605#2B40600000000000",
    ]
    assert "085#0000000000000000" in frames  # error reset


def test_a_streaming_cycle() -> None:
    with _rig(heartbeat_s=None) as (_, drive, spy), drive:
        drive.enable()
        with CyclicStream([drive], SetPointSettings(0.002)) as stream:
            stream.cycle([0.0])
            stream.cycle([0.0])
            spy.take()
            stream.cycle([0.01])
            assert spy.take() == [
                "205#64000000",  # 607Ah 100 counts; no controlword, which has an RPDO of its own
                "080#",
                "185#371600000000",  # enabled, follows the command (bit 12); still at 0
            ]
        drive.set_mode(Mode.PROFILE_POSITION)
