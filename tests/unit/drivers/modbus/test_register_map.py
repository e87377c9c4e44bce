"""Register maps: addresses in every manual's notation, values with scale and limits, and refusals that name their place."""

from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.register_maps import load_register_map

from drivers.clock import WallClock
from drivers.drive import DriveState
from drivers.errors import CapabilityError, InputError
from drivers.modbus.codec import Order, RegisterType
from drivers.modbus.drive_map import Handshake
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.plan import AddressSpace, Span
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.register_map import Memory, RegisterRights, find_map, shipped_maps
from drivers.modbus.touch_probe import ModbusTouchProbe
from drivers.touch_probe import Edge

HEAD = """\
[map]
name = "small"
address_base = "{base}"
word_order = "big"

"""
DRIVE = """
[registers.status]
address = 0
table = "holding"
type = "bits"
access = "ro"
bits = {{ on = 0, fault = 1, reached = 2 }}

[registers.control]
address = 1
table = "holding"
type = "u16"

[registers.position]
address = 2
table = "holding"
type = "i32"
unit = "counts"

[registers.speed]
address = 4
table = "holding"
type = "u32"
unit = "counts/s"

[registers.nameplate]
address = 20
table = "holding"
type = "string"
length = 2

[registers.kept]
address = 30
table = "holding"
type = "i32"
unit = "counts"
memory = "eeprom"

[registers.order]
address = 40
table = "holding"
type = "u16"
access = "wo"

[drive]
position = "position"
state = [
    {{ register = "status", bit = "fault", state = "fault" }},
    {{ register = "status", bit = "on", state = "operation enabled" }},
    {{ register = "status", bit = "on", set = 0, state = "switch on disabled" }},
]
quick_stop = {{ write = [{{ register = "control", value = 2 }}] }}
halt = {{ write = [{{ register = "control", value = 3 }}] }}

[[drive.enable]]
from = ["switch on disabled"]
write = [{{ register = "control", mask = 1, value = 1 }}]
to = ["operation enabled"]

[[drive.disable]]
from = ["operation enabled"]
write = [{{ register = "control", value = 0 }}]
to = ["switch on disabled"]

[[drive.reset_fault]]
from = ["fault"]
write = [{{ register = "control", value = 4 }}]
to = ["switch on disabled"]

[drive.move]
handshake = "on write"
target = "position"
velocity = "speed"
window = 5
"""
SMALL = HEAD.format(base="pdu0") + DRIVE.format()

Write = Callable[[str], Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    def put(text: str) -> Path:
        path = tmp_path / "model.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return put


def one_register(base: str, body: str) -> str:
    return HEAD.format(base=base) + "[registers.it]\n" + body


@pytest.mark.parametrize(
    ("base", "address", "table", "start"),
    [
        ("pdu0", "0", 'table = "holding"', (AddressSpace.HOLDING, 0)),
        ("pdu0", "0x2000", 'table = "input"', (AddressSpace.INPUT, 0x2000)),
        ("one", "1", 'table = "holding"', (AddressSpace.HOLDING, 0)),
        ("modicon5", "40001", "", (AddressSpace.HOLDING, 0)),
        ("modicon5", "49999", "", (AddressSpace.HOLDING, 9998)),
        ("modicon5", "30010", 'table = "input"', (AddressSpace.INPUT, 9)),
        ("modicon5", "10001", "", (AddressSpace.DISCRETE, 0)),
        ("modicon5", '"00017"', "", (AddressSpace.COIL, 16)),
        ("modicon6", "400001", "", (AddressSpace.HOLDING, 0)),
        ("modicon6", "465536", "", (AddressSpace.HOLDING, 65535)),
        ("modicon6", "300001", "", (AddressSpace.INPUT, 0)),
    ],
)
def test_addresses_in_the_manuals_notation(
    write: Write, base: str, address: str, table: str, start: tuple[AddressSpace, int]
) -> None:
    kind = "" if start[0].is_bits else 'type = "u16"'
    registers = load_register_map(write(one_register(base, f"address = {address}\n{table}\n{kind}\n")))
    assert (registers["it"].table, registers["it"].span.start) == start


@pytest.mark.parametrize(
    ("base", "body", "what"),
    [
        ("pdu0", "address = 5\ntype = 'u16'", "lacks table"),
        ("pdu0", "address = 65536\ntable = 'holding'\ntype = 'u16'", "expected 0 to 65535"),
        ("one", "address = 0\ntable = 'holding'\ntype = 'u16'", "expected 1 to 65536"),
        ("pdu0", "address = 65535\ntable = 'holding'\ntype = 'u32'", "leaves the 65536 registers"),
        ("modicon5", "address = 400001\ntype = 'u16'", "expected a modicon5 address such as 40001"),
        ("modicon5", "address = 20001\ntype = 'u16'", "expected a modicon5 address"),
        ("modicon5", "address = 40000\ntype = 'u16'", "expected a modicon5 address"),
        ("modicon6", "address = 465537\ntype = 'u16'", "expected a modicon6 address"),
        ("modicon5", "address = 40001\ntable = 'input'\ntype = 'u16'", "address 40001 is of table holding"),
        ("pdu0", "address = 1\ntable = 'holding'", "lacks type"),
        ("pdu0", "address = 1\ntable = 'holding'\ntype = 'u24'", "expected bit, bits, u16"),
        ("pdu0", "address = 1\ntable = 'coil'\ntype = 'u16'", "which table coil cannot hold"),
        ("pdu0", "address = 1\ntable = 'holding'\ntype = 'bit'", "which table holding cannot hold"),
        ("pdu0", "address = 1\ntable = 'input'\ntype = 'u16'\naccess = 'rw'", "table input is read only"),
        ("pdu0", "address = 1\ntable = 'holding'\ntype = 'u16'\nscale = 0", "expected a number other than 0"),
        ("pdu0", "address = 1\ntable = 'holding'\ntype = 'u16'\nscale = true", "expected a number other than 0"),
        ("pdu0", "address = 1\ntable = 'holding'\ntype = 'u16'\nlimits = [5, 1]", "expected [low, high]"),
        ("pdu0", "address = 1\ntable = 'holding'\ntype = 'u16'\nbits = { a = 1 }", "belongs to the type bits"),
        ("pdu0", "address = 1\ntable = 'holding'\ntype = 'bits'\nbits = { a = 16 }", "bit number, 0 to 15"),
        ("pdu0", "address = 1\ntable = 'holding'\ntype = 'u16'\nword_order = 'middle'", "expected big or little"),
        ("pdu0", "address = 1.5\ntable = 'holding'\ntype = 'u16'", "expected a whole number"),
    ],
)
def test_a_bad_register_is_refused_with_its_place(write: Write, base: str, body: str, what: str) -> None:
    path = write(one_register(base, body.replace("'", '"') + "\n"))
    with pytest.raises(InputError) as caught:
        load_register_map(path)
    assert what in str(caught.value)
    assert str(caught.value).startswith(
        (f"{path}:{caught.value.line}: [registers.it] ", f"{path}:10: [registers.it.bits] ")
    )
    assert caught.value.line is not None
    assert caught.value.line >= 6  # the header of [registers.it], or the key's own line


def replaced(old: str, new: str) -> str:
    assert SMALL.count(old) >= 1, old
    return SMALL.replace(old, new, 1)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (SMALL + "\n[extra]\nx = 1\n", "unknown key extra"),
        (replaced('name = "small"', 'name = "small"\nspeed = 1'), "[map] unknown key speed"),
        (replaced('bit = "fault", state', 'bit = "fault", value = 2, state'), "bit stands beside a mask or value"),
        (replaced('"control", value = 2', '"control", value = 2, set = 1'), "set is for a named bit"),
        (replaced('"control", value = 2', '"control", value = 2, not_value = 1'), "unknown key not_value"),
        (replaced('"control", value = 2', '"control", valeu = 2'), "unknown key valeu, the nearest known one is value"),
        (replaced('"control", value = 2', '"control"'), "lacks value, expected a whole number 0 to 65535"),
        (replaced('type = "u16"\n', 'type = "u16"\nlength = 2\n'), "length belongs to the type string"),
        (
            replaced("window = 5", "window = 5\nwindw = 1"),
            "[drive.move] unknown key windw, the nearest known one is window",
        ),
        (replaced("window = 5", ""), "lacks window"),
        (replaced('target = "position"', 'target = "kept"'), "kept in EEPROM; motion would wear it out"),
        (replaced('target = "position"', 'target = "status"'), "read only"),
        (replaced('velocity = "speed"', 'velocity = "position"'), "expected a unit of counts/s, rpm, rev/s"),
        (replaced('velocity = "speed"', 'velocity = "sped"'), "expected the name of a register"),
        (replaced('position = "position"', 'position = "order"'), "write only"),
        (replaced('position = "position"', 'position = "nameplate"'), "expected a unit of counts, rev"),
        (replaced('bit = "fault", state', 'bit = "falt", state'), "expected a bit of status (on, fault, reached)"),
        (replaced('state = "fault"', 'state = "broken"'), "expected not ready to switch on, switch on disabled"),
        (replaced('{ register = "status", bit = "fault", state = "fault" },', ""), "has no rule for 'fault'"),
        (replaced('to = ["operation enabled"]', 'to = ["switched on"]'), "which no rule in drive.state shows"),
        (replaced('to = ["operation enabled"]', 'to = ["switch on disabled"]'), "has no way from 'switch on disabled'"),
        (
            replaced('from = ["switch on disabled"]', 'from = ["switch on disabled", "fault"]'),
            "a fault is reset on purpose",
        ),
        (
            replaced('value = 4 }]\nto = ["switch on disabled"]', 'value = 4 }]\nto = ["operation enabled"]'),
            "a reset leaves the axis disabled",
        ),
        (
            replaced('from = ["operation enabled"]', 'from = ["switch on disabled"]'),
            "has no way out of operation enabled",
        ),
        (replaced('"control", mask = 1, value = 1', '"control", mask = 1, value = 3'), "bits outside the mask"),
        (replaced('"control", mask = 1, value = 1', '"control", mask = 0x10000, value = 0'), "does not fit control"),
        (replaced('"control", mask = 1, value = 1', '"order", mask = 1, value = 1'), "needs order to be readable"),
        (replaced('"control", value = 2', '"control", value = 65536'), "expected a whole number 0 to 65535"),
        (replaced('"control", value = 2', '"nameplate", value = 2'), "no whole number"),
        (replaced('"control", value = 2', '"kept", value = 2'), "commands would wear it out"),
        (
            replaced('quick_stop = { write = [{ register = "control", value = 2 }] }', ""),
            "lacks the table [drive.quick_stop]",
        ),
        (replaced("address = 1\n", "address = 3\n"), "overlaps"),
        (replaced("[registers.status]", "[registers.status"), "is not TOML"),
    ],
)
def test_a_drive_that_cannot_work_is_refused(write: Write, text: str, what: str) -> None:
    path = write(text)
    with pytest.raises(InputError) as caught:
        load_drive_map(path)
    assert what in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.path == str(path)
    assert caught.value.line is not None or "unknown key" in what or "lacks the table" in what


PROBE = """
[[drive.touch_probe]]
number = 1
off = [{ register = "control", mask = 0x30, value = 0 }]
on = [{ register = "control", mask = 0x10, value = 0x10 }]

[drive.touch_probe.positive]
arm = [{ register = "control", mask = 0x20, value = 0x20 }]
latched = [{ register = "status", bit = "reached" }]
position = "position"
"""


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (SMALL + '[drive.stream]\ntarget = "position"\n', "lacks least_period_s"),
        (SMALL + '[drive.stream]\ntarget = "kept"\nleast_period_s = 0.01\n', "motion would wear it out"),
        (SMALL + PROBE + PROBE, "has two probes of one number"),
        (SMALL + PROBE.partition("[drive.touch_probe.positive]")[0], "expected at least one edge"),
        (SMALL + PROBE.replace('position = "position"', 'position = "status"'), "expected a unit of counts, rev"),
        (SMALL + PROBE.replace("latched", "latch"), "unknown key latch, the nearest known one is latched"),
        (
            SMALL + PROBE.replace('latched = [{ register = "status", bit = "reached" }]', ""),
            "lacks latched, expected a list of tables",
        ),
        (SMALL + PROBE.replace("number = 1", "number = 0"), "expected the number of the input, 1 to 16"),
    ],
)
def test_runs_streams_and_probes_that_cannot_work_are_refused(write: Write, text: str, what: str) -> None:
    with pytest.raises(InputError) as caught:
        load_drive_map(write(text))
    assert what in str(caught.value)
    assert caught.value.line is not None


def test_a_probe_that_latches_one_edge_once_says_what_it_cannot_do(write: Write) -> None:
    probes = load_drive_map(write(SMALL + PROBE)).probes
    assert [(probe.number, list(probe.edges), probe.continuous) for probe in probes] == [(1, [Edge.POSITIVE], ())]
    access = cast("RegisterAccess", None)  # refused before anything is asked of it

    class Off(ModbusTouchProbe):
        def _switch_off(self, probe: int) -> None: ...

    probe = Off("X", WallClock(), probes, access, lambda _raw, _name: 0.0)
    with pytest.raises(CapabilityError, match="touch probe 1 does not latch negative edges"):
        probe.arm(1, [Edge.NEGATIVE])
    with pytest.raises(CapabilityError, match="does not latch each edge, only the next one"):
        probe.arm(1, [Edge.POSITIVE], continuous=True)
    with pytest.raises(InputError, match="expected probe 1 and at least one edge"):
        probe.arm(2, [Edge.POSITIVE])


def test_the_small_drive_is_read_as_written(write: Write) -> None:
    drive = load_drive_map(write(SMALL))
    assert drive.sampled() == ("position", "status")
    assert drive.move.handshake is Handshake.ON_WRITE
    assert [rule.state for rule in drive.states] == [
        DriveState.FAULT,
        DriveState.ENABLED,
        DriveState.SWITCH_ON_DISABLED,
    ]
    assert drive.states[0].condition.holds(0b010)
    assert not drive.states[0].condition.holds(0b101)
    with pytest.raises(InputError, match="has no register 'velocity'"):
        _ = drive.registers["velocity"]


def test_a_long_register_overlapping_several_is_found(write: Write) -> None:
    text = HEAD.format(base="pdu0") + (
        '[registers.a]\naddress = 0\ntable = "holding"\ntype = "u64"\n'
        '[registers.b]\naddress = 1\ntable = "holding"\ntype = "u16"\n'
    )
    with pytest.raises(InputError, match="overlaps a: both take the holding at 1"):
        load_register_map(write(text))
    assert load_register_map(write(text.replace('1\ntable = "holding"', '1\ntable = "input"')))


def test_values_scale_and_are_held_to_their_limits(write: Write) -> None:
    body = (
        'address = 1\ntable = "holding"\ntype = "i16"\nscale = 0.1\noffset = -40.0\nunit = "°C"\nlimits = [-40, 100]\n'
    )
    register = load_register_map(write(one_register("pdu0", body)))["it"]
    assert register.decode((652,)) == pytest.approx(25.2)
    assert register.encode(25.2) == (652,)
    assert register.encode(-40.0) == (0,)
    for value in (-40.1, 100.1):
        with pytest.raises(InputError, match=r"it cannot be .* °C, allowed is -40 to 100"):
            register.raw_of(value)
    for value in (float("nan"), float("inf")):
        with pytest.raises(InputError, match="expected a finite number"):
            register.raw_of(value)


def test_integers_without_scale_stay_exact(write: Write) -> None:
    body = 'address = 1\ntable = "holding"\ntype = "u64"\n'
    register = load_register_map(write(one_register("pdu0", body)))["it"]
    value = 2**63 + 1
    assert register.decode(register.encode(value)) == value
    with pytest.raises(InputError, match=r"it: value .* does not fit a u64"):
        register.encode(-1)


def test_finding_a_map(tmp_path: Path) -> None:
    assert {"cia402_over_modbus", "vendor_style", "leadshine_el7"} < set(shipped_maps())
    assert find_map("vendor_style") == shipped_maps()["vendor_style"]
    with pytest.raises(
        InputError, match=r"neither a file nor a shipped register map \(.*leadshine_el7, .*vendor_style\)"
    ):
        find_map(tmp_path / "none.toml")


def test_the_shipped_maps_are_complete_and_of_different_shape() -> None:
    cia402, vendor = load_drive_map("cia402_over_modbus"), load_drive_map("vendor_style")
    for drive in (cia402, vendor):
        for role in (drive.velocity, drive.torque, drive.following_error, drive.fault_code, drive.homing):
            assert role is not None
    assert cia402.move.handshake is Handshake.SET_POINT_BIT
    assert vendor.move.handshake is Handshake.TRIGGER
    target = vendor.registers["target"]
    assert (target.span, target.layout.type, target.layout.word_order) == (Span(0, 2), RegisterType.I32, Order.LITTLE)
    assert vendor.registers["servo_on"].table is AddressSpace.COIL
    assert vendor.registers["name_plate"].access is RegisterRights.RO
    assert vendor.registers["origin_offset"].memory is Memory.EEPROM
    assert cia402.registers["statusword"].span == Span(0x2000, 1)


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        # CiA 402 / IEC 61800-7-201, table of statusword bits: xxxx xxxx x0xx 0000 and so on, don't-care bits set and clear
        (0x0000, DriveState.NOT_READY),
        (0xFFB0, DriveState.NOT_READY),
        (0x0250, DriveState.SWITCH_ON_DISABLED),
        (0x0240, DriveState.SWITCH_ON_DISABLED),
        (0x0231, DriveState.READY),
        (0x0233, DriveState.SWITCHED_ON),
        (0x0637, DriveState.ENABLED),
        (0x1627, DriveState.ENABLED),
        (0x0217, DriveState.QUICK_STOP),
        (0x021F, DriveState.FAULT_REACTION),
        (0x0218, DriveState.FAULT),
        (0x0008, DriveState.FAULT),
    ],
)
def test_statuswords_of_the_standard(statusword: int, state: DriveState) -> None:
    rules = load_drive_map("cia402_over_modbus").states
    assert [rule.state for rule in rules if rule.condition.holds(statusword)] == [state]


# -- damaged maps --------------------------------------------------------------------------------------------------
TEXTS = {name: path.read_text(encoding="utf-8") for name, path in shipped_maps().items()}
VALUES = [
    '""',
    "-1",
    "0",
    "1.5",
    "true",
    "nan",
    "inf",
    "[]",
    "{}",
    '"x"',
    "99999999999",
    "[1, 2]",
    "1979-05-27",
    '["fault"]',
]


def _load(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")
    complaint = ""
    try:
        load_drive_map(path)
    except InputError as error:
        complaint = str(error)
    assert "\n" not in complaint
    assert not complaint or str(path) in complaint


@settings(max_examples=30, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_lines(tmp_path: Path, data: st.DataObject) -> None:
    lines = TEXTS[data.draw(st.sampled_from(sorted(TEXTS)))].splitlines()
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(lines) - 1))
        match data.draw(st.sampled_from(["drop", "double", "value", "key", "cut", "swap"])):
            case "drop":
                del lines[place]
            case "double":
                lines.insert(place, lines[place])
            case "value":
                lines[place] = f"{lines[place].partition('=')[0]}= {data.draw(st.sampled_from(VALUES))}"
            case "key":
                lines[place] = "x" + lines[place]
            case "cut":
                lines[place] = lines[place][: data.draw(st.integers(0, len(lines[place])))]
            case "swap":
                other = data.draw(st.integers(0, len(lines) - 1))
                lines[place], lines[other] = lines[other], lines[place]
    _load(tmp_path / "model.toml", "\n".join(lines))


def test_a_file_that_is_no_text_and_one_that_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "model.toml"
    path.write_bytes(b"[map]\xff")
    with pytest.raises(InputError, match="is not UTF-8 text"):
        load_drive_map(path)
    with pytest.raises(InputError, match="is neither a file nor a shipped register map"):
        load_drive_map(tmp_path)
