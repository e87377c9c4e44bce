"""What a register map of a maker's drive may say: addresses by parameter number, facts and their strength, evidence of word orders."""

from __future__ import annotations

import json
import resource
import signal
from pathlib import Path

import pytest
from support.register_maps import load_register_map

from drivers.errors import InputError
from drivers.facts import Strength
from drivers.modbus.codec import Layout, Order, RegisterType, encode
from drivers.modbus.drive_values import from_counts, to_counts
from drivers.modbus.map_facts import FactLedger, Origin, Proof
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.map_roles import Condition
from drivers.modbus.plan import AddressSpace, Span, WireCost, plan_reads
from drivers.modbus.register_map import Register, find_map
from drivers.modbus.word_order_evidence import judge_orders

MAP = """\
[map]
name = "rules"
address_base = "pdu0"
table = "holding"
word_order = "big"
strength = "run"
source = "a manual"
{rules}
[registers]
value = {{ address = "{number}", type = "{kind}"{more} }}
"""
LEADSHINE = """
[[map.address_rules]]
groups = [0, 7]
first = 1
step = 2
high_word_before = true
[[map.address_rules]]
groups = [8, 8]
first = 0x5800
"""
DELTA = "[[map.address_rules]]\nstep = 2\n"
INOVANCE = "[[map.address_rules]]\ngroup_base = 16\n"
A6 = "[[map.address_rules]]\ngroup_base = 16\nindex_base = 16\n"
JMC = "[[map.address_rules]]\npage = 100\n"


def only(tmp_path: Path, **parts: str) -> Register:
    path = tmp_path / "map.toml"
    path.write_text(
        MAP.format(**{"rules": DELTA, "number": "P0-00", "kind": "u16", "more": "", **parts}), encoding="utf-8"
    )
    return load_register_map(path)["value"]


@pytest.mark.parametrize(
    ("rules", "number", "kind", "address"),
    [  # as the notes on each family state them
        (LEADSHINE, "P0.01", "u16", 0x0003),
        (LEADSHINE, "P4.00", "u16", 0x0401),
        (LEADSHINE, "P5.31", "u16", 0x053F),
        (LEADSHINE, "Pr0.08", "u32", 0x0010),
        (LEADSHINE, "Pr8.23", "u16", 0x6017),
        (DELTA, "P5-07", "u16", 0x050E),
        (DELTA, "P5-60", "u32", 0x0578),
        (INOVANCE, "H0B.34", "u16", 0x0B22),
        (INOVANCE, "P17-33", "u16", 0x1721),
        (A6, "C0A.05", "u16", 0x0A05),
        (A6, "C11.0A", "u32", 0x110A),
        (JMC, "P03-09", "u16", 0x0135),
        (JMC, "P04-14", "u16", 0x019E),
    ],
)
def test_a_parameter_number_becomes_its_address(
    rules: str, number: str, kind: str, address: int, tmp_path: Path
) -> None:
    assert only(tmp_path, rules=rules, number=number, kind=kind).span.start == address


@pytest.mark.parametrize(("rules", "number"), [(LEADSHINE, "P9.00"), (DELTA, "P5"), (DELTA, "P1-0A"), ("", "P1-01")])
def test_a_number_that_no_rule_covers_is_refused_with_its_line(rules: str, number: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"map.toml:\d+: \[registers.value\] address is '.*', which no rule"):
        only(tmp_path, rules=rules, number=number)


def test_a_register_has_the_files_source_unless_it_states_its_own(tmp_path: Path) -> None:
    assert only(tmp_path).origin == Origin("a manual", strength=Strength.RUN)
    assert only(tmp_path, more=', strength = "general"').origin == Origin(
        "none that was read", strength=Strength.GENERAL
    )
    own = only(tmp_path, more=', strength = "maker", source = "page 12"').origin
    assert own == Origin("page 12", strength=Strength.MAKER)
    assert not own.verified_on_hardware


@pytest.mark.parametrize("unit", ["ms/1000rpm", "ms/3000rpm"])
def test_a_ramp_given_by_its_time_is_never_steeper_than_asked(unit: str, tmp_path: Path) -> None:
    register = only(tmp_path, kind="u16", more=f', unit = "{unit}", limits = [1, 65535]')
    rpm = float(unit[3:-3])
    for asked_ms in (1, 7.5, 100, 333.3, 20_000):
        counts_s2 = rpm / 60.0 * 10_000 / (asked_ms / 1000.0)
        raw = from_counts(counts_s2, register, 10_000)
        assert asked_ms - 1e-6 <= raw < asked_ms + 1.0
        assert to_counts(raw, register, 10_000) <= counts_s2 * (1 + 1e-9)
    assert from_counts(1.0, register, 10_000) == 65535, "the gentlest that the drive has"


def test_a_condition_takes_one_of_several_values_or_none_of_them() -> None:
    running = Condition("trigger", None, (1, 10001))
    assert [running.holds(value) for value in (1, 10001, 20001)] == [True, True, False]
    assert not Condition("trigger", None, (1, 10001), negate=True).holds(10001)


def test_objects_by_index_are_read_one_by_one() -> None:
    wanted = [
        (AddressSpace.HOLDING, Span(0x6083, 2)),
        (AddressSpace.HOLDING, Span(0x6084, 2)),
        (AddressSpace.HOLDING, Span(0x6041, 1)),
    ]
    cost = WireCost.tcp()
    assert [each.span for each in plan_reads(wanted, cost, apart=True).requests] == [span for _, span in wanted]
    assert len(plan_reads(wanted, cost).requests) < 3
    assert load_drive_map("mitsubishi_mr_je_c").registers.one_value_per_request


# -- evidence of word orders ---------------------------------------------------------------------------------------------
def held(
    value: int, drive: Order, mapped: Order, kind: RegisterType = RegisterType.I32
) -> dict[str, tuple[Register, tuple[int, ...]]]:
    register = Register("p", AddressSpace.HOLDING, Span(0, 2), Layout(kind, mapped))
    return {"p": (register, encode(value, Layout(kind, drive)))}


@pytest.mark.parametrize("value", [1, -1_000, 12_345, 1_234_567, -2_000_000])
@pytest.mark.parametrize("drive", Order)
def test_a_position_of_some_turns_tells_the_order(value: int, drive: Order) -> None:
    for mapped in Order:
        verdict = judge_orders(held(value, drive, mapped))
        assert verdict.agrees is (mapped is drive)
        assert verdict.supported is (mapped is drive)


@pytest.mark.parametrize("value", [0, -1, 0x00050005])
def test_a_value_that_reads_alike_tells_nothing_and_says_what_to_do(value: int) -> None:
    for mapped in Order:
        verdict = judge_orders(held(value, Order.BIG, mapped))
        assert (verdict.agrees, verdict.supported) == (True, False)
        assert "turn the motor some turns by hand" in verdict.detail


# -- what was proven -----------------------------------------------------------------------------------------------------
def test_proofs_belong_to_one_drive_and_one_text_of_its_map(tmp_path: Path) -> None:
    map_file, path = tmp_path / "map.toml", tmp_path / "store" / "facts.json"
    map_file.write_text("one")
    ledger = FactLedger(path, "tcp unit 1", map_file)
    assert ledger.proven() == frozenset()
    ledger.add(frozenset({Proof.MOVE}))
    ledger.add(frozenset({Proof.STOP}))
    assert FactLedger(path, "tcp unit 1", map_file).proven() == {Proof.MOVE, Proof.STOP}
    assert FactLedger(path, "tcp unit 2", map_file).proven() == frozenset()
    map_file.write_text("another")
    assert FactLedger(path, "tcp unit 1", map_file).proven() == frozenset()
    path.write_text(json.dumps({"x": ["nonsense"]}))
    with pytest.raises(InputError, match="does not say which facts were proven"):
        ledger.proven()


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('why = "x"\nby_us = true', "control_mode cannot"),
        ('remedy = "x"', "lacks why"),
    ],
)
def test_a_need_that_cannot_be_met_is_refused(line: str, words: str, tmp_path: Path) -> None:
    text = find_map("leadshine_el7").read_text(encoding="utf-8")
    before = 'why = "moves go through path 0 of the PR mode"\nremedy = "set Pr0.01 = 6 and switch the drive off and on"'
    assert before in text
    (tmp_path / "mine.toml").write_text(text.replace(before, line), encoding="utf-8")
    with pytest.raises(InputError, match=words):
        load_drive_map(tmp_path / "mine.toml")


def test_proofs_that_cannot_be_written_leave_the_old_ones(tmp_path: Path) -> None:
    """The operating system refuses bytes beyond a size, as a full disk does."""
    map_file, path = tmp_path / "map.toml", tmp_path / "facts.json"
    map_file.write_text("x")
    FactLedger(path, "tcp unit 1", map_file).add(frozenset({Proof.MOVE}))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    old_handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, before[1]))
    try:
        with pytest.raises(InputError, match="File too large"):
            FactLedger(path, "tcp unit 1", map_file).add(frozenset({Proof.STOP}))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, old_handler)
    assert FactLedger(path, "tcp unit 1", map_file).proven() == {Proof.MOVE}
    assert sorted(tmp_path.iterdir()) == [path, map_file]
