"""Grouping of requests: always covering, never too long, never splitting a value, as cheap as any other grouping."""

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from drivers.modbus.plan import AddressSpace, ReadRequest, Span, WireCost, group_writes, plan_reads, silent_interval_s

RTU = WireCost.rtu(115_200, drive_s=0.0)
HOLDING = AddressSpace.HOLDING
spans = st.builds(Span, st.integers(0, 600), st.integers(1, 8))
costs = st.one_of(
    st.builds(WireCost.rtu, st.sampled_from([1200, 9600, 19200, 115_200]), st.floats(0, 0.02)),
    st.builds(WireCost.tcp, st.floats(0, 0.01)),
)


def test_wire_times_of_a_115200_baud_line() -> None:
    """The figures of the field notes: 4.9 ms for one register, 28.6 ms for 125, 10.6 ms for a verified 32-bit write."""
    assert RTU.read_s(HOLDING, 1) * 1e3 == pytest.approx(4.9, abs=0.05)
    assert RTU.read_s(HOLDING, 125) * 1e3 == pytest.approx(28.6, abs=0.05)
    assert (RTU.write_s(HOLDING, 2) + RTU.read_s(HOLDING, 2)) * 1e3 == pytest.approx(10.6, abs=0.05)


def test_wire_time_counts_every_byte_of_the_frames() -> None:
    # request 01 03 aaaa nnnn crc = 8, reply 01 03 n data crc = 5 + 2n; 9600 baud, 11 bits
    cost = WireCost.rtu(9600, drive_s=0.0)
    assert cost.read_s(HOLDING, 3) == pytest.approx((8 + 11) * 11 / 9600 + 2 * 38.5 / 9600)
    # write one: 8 each way; write three: 01 10 aaaa nnnn b data crc = 9 + 6, reply 8; ten coils read: 8 and 5 + 2
    assert cost.write_s(HOLDING, 1) == pytest.approx(16 * 11 / 9600 + 77 / 9600)
    assert cost.write_s(HOLDING, 3) == pytest.approx(23 * 11 / 9600 + 77 / 9600)
    assert cost.read_s(AddressSpace.COIL, 10) == pytest.approx(15 * 11 / 9600 + 77 / 9600)


@pytest.mark.parametrize(("baud", "expected_s"), [(9600, 38.5 / 9600), (19200, 38.5 / 19200), (38400, 0.00175)])
def test_silent_interval(baud: int, expected_s: float) -> None:
    assert silent_interval_s(baud) == pytest.approx(expected_s)


def test_a_gap_is_read_along_as_long_as_that_is_cheaper() -> None:
    """A second request has 13 bytes and two silent intervals of 1.75 ms, 36.7 characters: as much as 24 registers."""
    within = plan_reads([(HOLDING, Span(0, 1)), (HOLDING, Span(25, 1))], RTU)
    beyond = plan_reads([(HOLDING, Span(0, 1)), (HOLDING, Span(26, 1))], RTU)
    assert len(within.requests) == 1
    assert len(beyond.requests) == 2


def test_a_drive_that_refuses_gaps_gets_none() -> None:
    plan = plan_reads([(HOLDING, Span(0, 2)), (HOLDING, Span(2, 2)), (HOLDING, Span(5, 1))], RTU, gaps_readable=False)
    assert plan.requests == (ReadRequest(HOLDING, Span(0, 4)), ReadRequest(HOLDING, Span(5, 1)))


def test_what_must_not_be_read_is_never_bridged() -> None:
    wanted = [(HOLDING, Span(0, 1)), (HOLDING, Span(3, 1))]
    assert len(plan_reads(wanted, RTU, avoid=[(HOLDING, Span(2, 1))]).requests) == 2
    assert len(plan_reads(wanted, RTU, avoid=[(HOLDING, Span(1, 2))]).requests) == 2
    assert len(plan_reads(wanted, RTU, avoid=[(HOLDING, Span(4, 2)), (AddressSpace.INPUT, Span(1, 1))]).requests) == 1


@given(
    wanted=st.lists(st.tuples(st.sampled_from(AddressSpace), spans), min_size=1, max_size=30),
    cost=costs,
    gaps=st.booleans(),
)
def test_every_value_is_covered_whole_by_one_legal_request(
    wanted: list[tuple[AddressSpace, Span]], cost: WireCost, gaps: bool
) -> None:
    plan = plan_reads(wanted, cost, gaps_readable=gaps)
    for table, span in wanted:
        assert any(request.table is table and request.span.covers(span) for request in plan.requests)
    for request in plan.requests:
        assert request.span.count <= (2000 if request.table.is_bits else 125)
        if not gaps:
            asked = {each for table, span in wanted if table is request.table for each in range(span.start, span.end)}
            assert set(range(request.span.start, request.span.end)) <= asked
    for first, second in itertools.combinations(plan.requests, 2):
        if first.table is second.table:
            assert first.span.end <= second.span.start or second.span.end <= first.span.start
    assert plan.wire_s == pytest.approx(sum(cost.read_s(each.table, each.span.count) for each in plan.requests))


@given(
    starts=st.lists(st.integers(0, 150), min_size=1, max_size=7, unique=True),
    cost=costs,
    limit=st.integers(4, 125),
)
def test_no_other_grouping_is_cheaper(starts: list[int], cost: WireCost, limit: int) -> None:
    starts = sorted(starts)
    plan = plan_reads([(HOLDING, Span(start, 1)) for start in starts], cost, max_registers=limit)
    cheapest = min(
        sum(cost.read_s(HOLDING, run[-1] - run[0] + 1) for run in runs)
        for runs in _all_cuts(starts)
        if all(run[-1] - run[0] + 1 <= limit for run in runs)
    )
    assert plan.wire_s == pytest.approx(cheapest)


def _all_cuts(starts: list[int]) -> list[list[list[int]]]:
    cuts = []
    for pattern in itertools.product([False, True], repeat=len(starts) - 1):
        runs = [[starts[0]]]
        for cut, start in zip(pattern, starts[1:], strict=True):
            if cut:
                runs.append([start])
            else:
                runs[-1].append(start)
        cuts.append(runs)
    return cuts


def test_a_value_longer_than_a_request_may_be_is_refused() -> None:
    with pytest.raises(InputError, match="cannot be read at once"):
        plan_reads([(HOLDING, Span(0, 8))], RTU, max_registers=4)
    with pytest.raises(InputError, match="expected 1 to 125"):
        plan_reads([(HOLDING, Span(0, 1))], RTU, max_registers=126)
    with pytest.raises(InputError, match="0 to 65535"):
        Span(65535, 2)


def test_writes_are_joined_only_where_they_touch_and_never_reordered() -> None:
    target, speed, ramp = (HOLDING, Span(10, 2)), (HOLDING, Span(12, 2)), (HOLDING, Span(20, 2))
    assert group_writes([target, speed, ramp]) == [[0, 1], [2]]
    assert group_writes([speed, target]) == [[0], [1]]
    assert group_writes([target, (AddressSpace.COIL, Span(12, 1))]) == [[0], [1]]
    assert group_writes([target, speed], max_registers=3) == [[0], [1]]
    assert group_writes([]) == []


@given(st.lists(st.tuples(st.sampled_from([AddressSpace.COIL, HOLDING]), spans), max_size=20))
def test_written_groups_hold_every_write_once_in_order(writes: list[tuple[AddressSpace, Span]]) -> None:
    groups = group_writes(writes)
    assert [index for group in groups for index in group] == list(range(len(writes)))
    for group in groups:
        for before, after in itertools.pairwise(group):
            assert writes[before][1].end == writes[after][1].start
            assert writes[before][0] is writes[after][0]
