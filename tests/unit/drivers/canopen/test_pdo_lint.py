"""The PDO linter: each kind of mistake named, clean sets left alone, published cycle limits met."""

from collections.abc import Sequence
from dataclasses import replace

import pytest

from drivers.canopen.pdo import EVENT, SYNC_EVERY, PdoSpec
from drivers.canopen.pdo_lint import Cycle, MappableObject, PdoProblem, Severity, lint, predict, refuse_errors
from drivers.cia402 import objects
from drivers.cia402.objects import Entry
from drivers.errors import InputError


def _rpdo(node_id: int, *entries: Entry, number: int = 1, cob_id: int | None = None, kind: int = SYNC_EVERY) -> PdoSpec:
    return PdoSpec(number, False, (0x100 + 0x100 * number + node_id) if cob_id is None else cob_id, kind, entries)


def _tpdo(node_id: int, *entries: Entry, number: int = 1, cob_id: int | None = None, kind: int = SYNC_EVERY) -> PdoSpec:
    return PdoSpec(number, True, (0x080 + 0x100 * number + node_id) if cob_id is None else cob_id, kind, entries)


def _streaming(node_id: int) -> list[PdoSpec]:
    return [
        _rpdo(node_id, objects.CONTROLWORD, objects.TARGET_POSITION),
        _tpdo(node_id, objects.STATUSWORD, objects.POSITION_ACTUAL),
    ]


def _codes(findings: Sequence[PdoProblem]) -> list[str]:
    return [finding.code for finding in findings]


def test_a_sound_set_has_no_findings() -> None:
    assert lint({1: _streaming(1), 2: _streaming(2)}, cycle=Cycle(1000, 1_000_000)) == []


def test_the_controlword_mapped_twice() -> None:
    specs = [*_streaming(1), _rpdo(1, objects.CONTROLWORD, objects.MODE, number=2)]
    findings = lint({1: [*specs, _tpdo(1, objects.MODE_DISPLAY, number=2)]})
    assert _codes(findings) == ["mapped-twice"]
    assert str(findings[0]).startswith(
        "error mapped-twice: node 1: 6040h:00 controlword is mapped in RPDO 1 (201h) and in RPDO 2"
    )
    with pytest.raises(InputError, match="PDO mapping: node 1: 6040h"):
        refuse_errors(findings)


def test_more_than_64_bits_cannot_even_be_written_down() -> None:
    with pytest.raises(InputError, match=r"TPDO 1 \(181h\) maps 80 bits, at most 64 fit"):
        _tpdo(1, objects.STATUSWORD, objects.POSITION_ACTUAL, objects.VELOCITY_ACTUAL)


def test_the_mode_commanded_and_not_shown() -> None:
    specs = [_rpdo(1, objects.CONTROLWORD, objects.MODE), _tpdo(1, objects.STATUSWORD)]
    assert _codes(lint({1: specs})) == ["mode-unconfirmed"]


def test_the_controlword_without_statusword() -> None:
    assert "state-unseen" in _codes(lint({1: [_rpdo(1, objects.CONTROLWORD), _tpdo(1, objects.POSITION_ACTUAL)]}))


def test_streaming_blind() -> None:
    specs = [_rpdo(1, objects.TARGET_POSITION), _tpdo(1, objects.STATUSWORD)]
    findings = lint({1: specs})
    assert _codes(findings) == ["no-controlword", "no-feedback"]
    assert {finding.severity for finding in findings} == {Severity.WARNING}


@pytest.mark.parametrize("cob_id", [0x000, 0x010, 0x080, 0x085, 0x100, 0x120, 0x585, 0x605, 0x6E5, 0x705, 0x7E5])
def test_reserved_identifiers(cob_id: int) -> None:
    assert _codes(lint({1: [_tpdo(1, objects.STATUSWORD, cob_id=cob_id)]})) == ["cob-id"]


def test_two_senders_of_one_identifier() -> None:
    nodes = {1: [_tpdo(1, objects.STATUSWORD)], 2: [_tpdo(2, objects.STATUSWORD, cob_id=0x181)]}
    findings = lint(nodes)
    assert _codes(findings) == ["cob-id-clash"]
    assert findings[0].text == "node 2's TPDO 1 (181h) has the COB-ID of node 1's TPDO 1 (181h)"


def test_one_frame_for_several_nodes_is_only_pointed_out() -> None:
    nodes = {
        node_id: [_rpdo(node_id, objects.CONTROLWORD, cob_id=0x201), _tpdo(node_id, objects.STATUSWORD)]
        for node_id in (1, 2)
    }
    findings = lint(nodes)
    assert _codes(findings) == ["cob-id-shared"]
    assert findings[0].severity is Severity.WARNING


@pytest.mark.parametrize("kind", [241, 250, 253])
def test_reserved_transmission_types(kind: int) -> None:
    assert _codes(lint({1: [_rpdo(1, objects.TARGET_VELOCITY, kind=kind)]})) == ["kind"]


def test_the_dictionary_is_asked() -> None:
    good = MappableObject(16, mappable=True, readable=True, writable=True)
    dictionary = {
        (0x6040, 0): good,
        (0x6041, 0): replace(good, writable=False),
        (0x6064, 0): replace(good, bits=32, writable=False),
        (0x6077, 0): replace(good, mappable=False),
        (0x607A, 0): good,  # 16 bits in this drive
    }
    specs = [
        _rpdo(1, objects.CONTROLWORD, objects.TARGET_POSITION),
        _rpdo(1, objects.POSITION_ACTUAL, number=2, kind=EVENT),
        _tpdo(1, objects.STATUSWORD, objects.TORQUE_ACTUAL, objects.POSITION_ACTUAL),
        _tpdo(1, objects.VELOCITY_ACTUAL, number=2),
    ]
    texts = [finding.text for finding in lint({1: specs}, dictionaries={1: dictionary}) if finding.code == "mapping"]
    assert texts == [
        "node 1: RPDO 1 (201h): 607Ah:00 target position has 16 bits, mapped are 32",
        "node 1: RPDO 2 (301h): 6064h:00 position actual value is read-only and cannot be commanded",
        "node 1: TPDO 1 (181h): 6077h:00 torque actual value cannot be mapped",
        "node 1: TPDO 2 (281h): 606Ch:00 velocity actual value does not exist in this drive",
    ]


def test_a_stop_rpdo_may_map_the_controlword_beside_the_other_one() -> None:
    """It carries nothing but stops, so that a stale one cannot drop or start the axis."""
    stop = PdoSpec(2, False, 0x301, EVENT, (objects.CONTROLWORD,), only_stops=True)
    assert lint({1: [*_streaming(1), stop]}) == []
    assert _codes(lint({1: [*_streaming(1), replace(stop, only_stops=False)]})) == ["mapped-twice"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"kind": 1},  # would wait for SYNC
        {"entries": (objects.CONTROLWORD, objects.MODE)},
        {"entries": ()},
        {"transmit": True, "cob_id": 0x281},
    ],
)
def test_a_stop_rpdo_that_is_none_is_refused(wrong: dict[str, object]) -> None:
    stop = PdoSpec(2, False, 0x301, EVENT, (objects.CONTROLWORD,), only_stops=True)
    assert "stop-pdo" in _codes(lint({1: [*_streaming(1), replace(stop, **wrong)]}))  # type: ignore[arg-type]


@pytest.mark.parametrize(("axes", "period_us"), [(2, 1000), (5, 2000)])
def test_published_limits_fit(axes: int, period_us: int) -> None:
    """At most 70 % load: two axes at 1 ms, five at 2 ms; T <= 55 + 230 N µs."""
    nodes = {node_id: _streaming(node_id) for node_id in range(1, axes + 1)}
    load = predict(nodes, Cycle(period_us, 1_000_000))
    assert load.shortest_period_us == 55 + 230 * axes
    assert load.share <= 0.7
    assert lint(nodes, cycle=Cycle(period_us, 1_000_000)) == []


@pytest.mark.parametrize(("axes", "period_us", "code"), [(3, 1000, "load"), (6, 2000, "load"), (5, 1000, "cycle")])
def test_more_axes_do_not(axes: int, period_us: int, code: str) -> None:
    nodes = {node_id: _streaming(node_id) for node_id in range(1, axes + 1)}
    assert _codes(lint(nodes, cycle=Cycle(period_us, 1_000_000))) == [code]


def test_a_cycle_without_room_for_sdo_is_pointed_out() -> None:
    assert _codes(lint({1: _streaming(1)}, cycle=Cycle(500, 1_000_000, budget=0.9))) == ["no-room"]
