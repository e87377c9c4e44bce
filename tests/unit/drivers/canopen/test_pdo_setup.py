"""Putting PDOs into force on the simulated drive: in the prescribed order, verified, and put back."""

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace

import pytest
from support.can_bench import CanBench

from drivers.canopen.bus import CanLink
from drivers.canopen.pdo import COB_ID, EVENT, KIND, SYNC_EVERY, Pdo, PdoSpec
from drivers.canopen.pdo_setup import PdoRefusedError, PdoSetup, entry_of, read_image
from drivers.canopen.sdo import SdoClient
from drivers.cia402 import objects
from drivers.cia402.objects import DataType, Entry
from drivers.errors import AbortError, InputError, ProtocolError
from sim_backends.canopen_dictionary import WRONG_STATE, RefusedError
from sim_backends.canopen_faults import CanFault
from sim_backends.faults import CanFaultKind

NODE = 5
KEPT = (0x06010002, 0x06090030)
"""A read-only COB-ID, and an invalid value of one whose bit 31 a drive does not know (CiA 301, 7.2.4.3.17)."""
STREAM = PdoSpec(1, False, 0x205, SYNC_EVERY, (objects.CONTROLWORD, objects.TARGET_POSITION))
FEEDBACK = PdoSpec(1, True, 0x185, SYNC_EVERY, (objects.STATUSWORD, objects.POSITION_ACTUAL, objects.TORQUE_ACTUAL))


@pytest.fixture
def bench() -> CanBench:
    return CanBench((NODE,))


@pytest.fixture
def sdo(bench: CanBench) -> Iterator[SdoClient]:
    with CanLink(bench.port(), bench.clock) as link:
        yield SdoClient(link, NODE, "drive X")


def _parameters(bench: CanBench) -> dict[tuple[int, int], bytes]:
    """All PDO parameters; mapping entries above the count say nothing and are left out."""
    dictionary = bench.slave.dictionary
    return {
        (index, subindex): dictionary.raw((index, subindex))
        for index, subindex in dictionary.items
        if 0x1400 <= index < 0x1C00 and (not index & 0x200 or subindex <= dictionary.number(index, 0))
    }


def test_the_order_of_writes(bench: CanBench, sdo: SdoClient) -> None:
    """Disable, clear, map, count, type, enable (CiA-301, 7.5.2.36), as frames on the wire."""
    seen: list[str] = []
    spy = bench.wire.add_node()
    spy.on_frame = lambda cob_id, data, _now_ns: (
        seen.append(data.hex()) if cob_id == 0x605 and data[0] != 0x40 else None
    )
    PdoSetup(sdo, sdo.node_id, (FEEDBACK,)).apply(refuse=False)
    assert seen == [
        "23001801850100c0",
        "2f001a0000000000",
        "23001a0110004160",
        "23001a0220006460",
        "23001a0310007760",
        "2f001a0003000000",
        "2f00180201000000",
        "2300180185010040",
    ]


def test_nothing_is_written_when_it_is_as_wanted(bench: CanBench, sdo: SdoClient) -> None:
    PdoSetup(sdo, sdo.node_id, (FEEDBACK,)).apply(refuse=False)
    before = sdo.counters.transfers
    seen: list[bytes] = []
    spy = bench.wire.add_node()
    spy.on_frame = lambda cob_id, data, _now_ns: seen.append(data) if cob_id == 0x605 and data[0] != 0x40 else None
    PdoSetup(sdo, sdo.node_id, (FEEDBACK,)).apply(refuse=False)
    assert seen == []
    assert sdo.counters.transfers > before


def test_a_pdo_that_commands_the_same_is_switched_off_and_put_back(bench: CanBench, sdo: SdoClient) -> None:
    """The default RPDO 2 maps 6040h too: left in force, one stray frame of it would drop the axis."""
    found = _parameters(bench)
    setup = PdoSetup(sdo, NODE, (STREAM, FEEDBACK))
    setup.apply()
    dictionary = bench.slave.dictionary
    assert dictionary.number(0x1401, 1) & 0x80000000
    assert dictionary.number(0x1400, 1) == 0x205
    assert dictionary.number(0x1600, 2) == 0x607A0020
    setup.restore()
    assert _parameters(bench) == found


def test_the_linter_speaks_before_anything_is_written(bench: CanBench, sdo: SdoClient) -> None:
    found = _parameters(bench)
    blind = PdoSpec(1, True, 0x185, SYNC_EVERY, (objects.POSITION_ACTUAL,))
    second = PdoSpec(2, True, 0x285, SYNC_EVERY, (objects.POSITION_ACTUAL,))
    with pytest.raises(InputError, match="controlword is commanded but 6041h:00 statusword not sent"):
        PdoSetup(sdo, NODE, (STREAM, blind, second)).apply()
    assert _parameters(bench) == found


def test_a_refusal_half_way_leaves_the_drive_as_it_was(bench: CanBench, sdo: SdoClient) -> None:
    found = _parameters(bench)
    unmappable = Entry(0x2201, 0, DataType.U32, "backlash compensation")
    bad = PdoSpec(2, True, 0x285, SYNC_EVERY, (unmappable,))
    with pytest.raises(AbortError, match=r"TPDO 2 \(285h\) cannot be configured: .*object cannot be mapped"):
        PdoSetup(sdo, NODE, (STREAM, FEEDBACK, bad)).apply()
    assert _parameters(bench) == found


@pytest.mark.parametrize("nth", range(1, 20))
@pytest.mark.parametrize("count", [1, 0])
def test_a_refusal_of_any_write_leaves_the_drive_as_it_was(nth: int, count: int) -> None:
    fault = CanFault(CanFaultKind.SDO_WRITE_ABORTED, size=0x08000022, skip=nth - 1, count=1)
    bench = CanBench((NODE,), faults={NODE: [fault]})
    with CanLink(bench.port(), bench.clock) as link:
        sdo = SdoClient(link, NODE, "drive X")
        bench.slave.dictionary.set_number(0x1A00, 0, count)
        found, entries = _parameters(bench), [bench.slave.dictionary.raw((0x1A00, number)) for number in range(4)]
        try:
            PdoSetup(sdo, NODE, (STREAM, FEEDBACK)).apply()
        except AbortError:
            assert _parameters(bench) == found
            assert [bench.slave.dictionary.raw((0x1A00, number)) for number in range(4)] == entries
        else:
            assert nth > 15  # fewer writes than that were needed


@pytest.mark.parametrize("count", [0, 1])
def test_entries_behind_the_mapped_ones_are_put_back_too(bench: CanBench, sdo: SdoClient, count: int) -> None:
    dictionary = bench.slave.dictionary
    dictionary.set_number(0x1A00, 0, count)
    found = [dictionary.raw((0x1A00, subindex)) for subindex in range(4)]
    setup = PdoSetup(sdo, NODE, (STREAM, FEEDBACK))
    setup.apply()
    assert [dictionary.raw((0x1A00, subindex)) for subindex in range(4)] != found
    setup.restore()
    assert [dictionary.raw((0x1A00, subindex)) for subindex in range(4)] == found


def test_a_mapping_that_reads_back_otherwise_is_no_success(bench: CanBench, sdo: SdoClient) -> None:
    bench.slave.dictionary.on_read(0x1A00, 2, lambda: objects.VELOCITY_ACTUAL.mapping)
    with pytest.raises(ProtocolError, match=r"TPDO 1 reads back .*606Ch.*; written was 185h.*6064h"):
        PdoSetup(sdo, NODE, (STREAM, FEEDBACK)).apply()


Write = Callable[[int, int, bytes], bool]


def _intercept(bench: CanBench, takes: Write) -> None:
    """The drive's answer to writes. takes: called with each one, whether it is handled as usual; it may raise RefusedError."""
    dictionary = bench.slave.dictionary
    usual = dictionary.write
    dictionary.write = lambda *asked: usual(*asked) if takes(*asked) else None  # type: ignore[method-assign]


@pytest.mark.parametrize("spec", [STREAM, FEEDBACK], ids=["rpdo", "tpdo"])
@pytest.mark.parametrize("first", [0, 1], ids=["mapping", "entries"])
def test_a_mapping_that_is_answered_and_not_taken_is_never_in_force(
    bench: CanBench, sdo: SdoClient, spec: PdoSpec, first: int
) -> None:
    """The drive keeps what it was delivered with, whose frames would have the wanted COB-ID."""
    dictionary, pdo = bench.slave.dictionary, spec.pdo
    stale = objects.TORQUE_ACTUAL if pdo.transmit else objects.TARGET_VELOCITY
    for subindex in (1, 2, 3):
        dictionary.set_number(pdo.mapping, subindex, stale.mapping)
    dictionary.set_number(pdo.communication, 1, spec.cob_id + 0x100)
    found = _parameters(bench)
    enabled: list[int] = []

    def takes(index: int, subindex: int, data: bytes) -> bool:
        if (index, subindex) == (pdo.communication, COB_ID) and not data[3] & 0x80:
            enabled.append(data[0] | data[1] << 8)
        return index != pdo.mapping or subindex < first

    _intercept(bench, takes)
    with pytest.raises(ProtocolError, match=rf"{pdo.name} reads back .*; written was {spec.cob_id:03X}h"):
        PdoSetup(sdo, NODE, (spec,)).apply(refuse=False)
    assert enabled == [spec.cob_id + 0x100]
    assert _parameters(bench) == found


def _mapped_in_place(bench: CanBench, code: int) -> None:
    """TPDO 1 refuses its COB-ID with this code, and takes a mapping while it is in force."""
    dictionary, pdo = bench.slave.dictionary, FEEDBACK.pdo

    def takes(index: int, subindex: int, data: bytes) -> bool:
        if (index, subindex) == (pdo.communication, COB_ID):
            raise RefusedError(code)
        if index == pdo.mapping:
            if subindex and dictionary.number(pdo.mapping, 0):
                raise RefusedError(WRONG_STATE)
            dictionary.set_number(index, subindex, int.from_bytes(data, "little"))
        return index != pdo.mapping

    _intercept(bench, takes)


@pytest.mark.parametrize("code", KEPT, ids=["read-only", "no-bit-31"])
def test_a_pdo_that_cannot_be_switched_off_is_mapped_with_a_count_of_0(
    bench: CanBench, sdo: SdoClient, code: int
) -> None:
    _mapped_in_place(bench, code)
    PdoSetup(sdo, sdo.node_id, (FEEDBACK,)).apply(refuse=False)
    assert read_image(sdo, FEEDBACK.pdo).mapped == tuple(entry.mapping for entry in FEEDBACK.entries)
    found = _parameters(bench)
    with pytest.raises(AbortError, match=r"TPDO 1 \(186h\) cannot be configured"):
        PdoSetup(sdo, sdo.node_id, (replace(FEEDBACK, cob_id=0x186, entries=FEEDBACK.entries[:1]),)).apply(refuse=False)
    assert _parameters(bench) == found


def test_a_pdo_that_is_not_switched_off_for_another_reason_is_not_mapped(bench: CanBench, sdo: SdoClient) -> None:
    found = _parameters(bench)
    _mapped_in_place(bench, WRONG_STATE)
    with pytest.raises(AbortError, match=r"TPDO 1 \(185h\) cannot be configured"):
        PdoSetup(sdo, sdo.node_id, (FEEDBACK,)).apply(refuse=False)
    assert _parameters(bench) == found


@pytest.mark.parametrize(
    ("code", "transmit", "stays"),
    [(KEPT[0], True, True), (KEPT[1], True, True), (WRONG_STATE, True, False), (KEPT[0], False, False)],
)
def test_a_pdo_that_stays_in_force_has_to_be_harmless(
    bench: CanBench, sdo: SdoClient, code: int, transmit: bool, stays: bool
) -> None:
    """The default RPDO 2 maps 6040h; the default TPDO 2 only adds to the load of the bus."""
    found, refused = _parameters(bench), []

    def takes(index: int, subindex: int, data: bytes) -> bool:
        if (index, subindex) == Pdo.numbered(2, transmit=transmit).setting(COB_ID).key:
            refused.append(data)
            raise RefusedError(code)
        return True

    _intercept(bench, takes)
    setup = PdoSetup(sdo, NODE, (STREAM, FEEDBACK), alone=True)
    with nullcontext() if stays else pytest.raises(AbortError):
        setup.apply()
        setup.restore()
    assert _parameters(bench) == found
    assert len(refused) == (1 if stays else 2)  # one that stayed in force is not put back


def test_a_mapping_that_cannot_be_read_back_is_no_refusal_of_what_was_written_last(
    bench: CanBench, sdo: SdoClient
) -> None:
    """The transmission type is the last write, and there is another type that could be tried."""
    found = _parameters(bench)
    dictionary, refusals = bench.slave.dictionary, [WRONG_STATE]
    usual, written = dictionary.read, list[tuple[int, int]]()

    def takes(index: int, subindex: int, _data: bytes) -> bool:
        written.append((index, subindex))
        return True

    def read(index: int, subindex: int) -> bytes:
        if (index, subindex) == (0x1A00, 2) and written[-1:] == [FEEDBACK.pdo.setting(KIND).key] and refusals:
            raise RefusedError(refusals.pop())
        return usual(index, subindex)

    _intercept(bench, takes)
    dictionary.read = read  # type: ignore[method-assign]
    with pytest.raises(
        PdoRefusedError, match=r"TPDO 1 \(185h\) cannot be read back: drive X: 1A00h:02 refused"
    ) as caught:
        PdoSetup(sdo, NODE, (FEEDBACK,)).apply(refuse=False)
    assert (caught.value.entry, caught.value.kind) == (None, False)
    assert _parameters(bench) == found


@pytest.mark.parametrize("nth", range(1, 70, 2))
def test_a_request_that_was_lost_is_made_again(nth: int) -> None:
    """The survey's reads come first, the writes are among the last 30 requests."""
    fault = CanFault(CanFaultKind.SDO_REQUEST_LOST, skip=nth - 1, count=1)
    bench = CanBench((NODE,), faults={NODE: [fault]})
    with CanLink(bench.port(), bench.clock) as link:
        sdo = SdoClient(link, NODE, "drive X", timeout_s=0.1)
        PdoSetup(sdo, NODE, (STREAM, FEEDBACK)).apply()
        assert sdo.counters.timeouts == 1
        assert [bench.slave.dictionary.number(0x1A00, number) for number in (0, 3)] == [
            3,
            objects.TORQUE_ACTUAL.mapping,
        ]


def test_the_drive_refuses_to_be_remapped_while_the_pdo_exists(sdo: SdoClient) -> None:
    with pytest.raises(AbortError, match="present device state"):
        sdo.write_bytes(0x1A00, 0, b"\x00")


def test_mapping_values_get_their_names_back() -> None:
    assert entry_of(0x60640020) == objects.POSITION_ACTUAL
    assert str(entry_of(0x21AB0310)) == "21ABh:03 object"
    assert entry_of(0x21AB0310).bits == 16


def test_an_event_driven_pdo_reads_back(sdo: SdoClient) -> None:
    spec = PdoSpec(3, True, 0x385, EVENT, (objects.ERROR_CODE,))
    PdoSetup(sdo, sdo.node_id, (spec,)).apply(refuse=False)
    image = read_image(sdo, spec.pdo)
    assert (image.numbers[False, KIND], image.mapped) == (255, (0x603F0010,))
