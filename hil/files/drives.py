"""`hil drives`: ready drive files with the source of each fact, and a first axis file from a drive that answers."""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from drivers.canopen import scan as canopen
from drivers.canopen.bus import CanLink
from drivers.canopen.eds import EdsFile, load_eds
from drivers.canopen.eds_text import summary
from drivers.canopen.sdo import SdoClient
from drivers.cia402 import objects
from drivers.cia402.modes import Mode
from drivers.cia402.objects import DataType, Entry
from drivers.cia402.units import motion_units, read_units, readings
from drivers.clock import WallClock
from drivers.drive_notes import DriveNotes, DriveWire, shipped_notes
from drivers.errors import BridgeError, InputError, NoAnswerError, TransportError
from drivers.files import replace_file
from drivers.modbus.drive_map import DriveMap, all_hold
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, parse_endpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.raw_parameters import ModbusLine, ModbusRawParameters
from drivers.modbus.register_access import RegisterAccess
from drivers.modbus.register_map import find_map, shipped_maps
from drivers.modbus.word_order_evidence import judge_orders
from drivers.named_parameters import NamedParameters
from hil.axis.axis_file import load_drive_axis
from hil.files.drives_shown import factory, wanted
from hil.files.first_axis_file import CANOPEN, Answers, FirstContact, axis_text
from hil.machine.who_is_there import canopen_nodes, modbus_units
from hil.records.zero import POSITION_DEPENDENT_METHODS, explain_homing, homing_risk
from hil.ui.terminal.output import write_json


# -- new ---------------------------------------------------------------------------------------------------------------
def run(args: argparse.Namespace) -> int:
    path = Path(args.file)
    if path.exists():
        raise InputError("exists already, expected a new file", path=path)
    if path.suffix != ".toml":
        raise InputError(f"is {args.file!r}, expected a name ending in .toml")
    ask = Answers(args)
    notes = shipped_notes().get(args.drive)
    if notes is not None and notes.head.no_file:
        raise InputError(f"there is no drive file for {notes.head.description}: {notes.head.no_file}")
    over_can = args.drive == CANOPEN or (notes is not None and notes.head.wire is DriveWire.CANOPEN)
    found = _canopen(args, ask, notes) if over_can else _modbus(args)
    if found.lines is None:
        for note in found.notes:
            print(note)
        print("no axis file is written")
        return 1
    replace_file(path, axis_text(ask, path.stem, found).encode())
    try:
        load_drive_axis(path)
    except BridgeError:
        path.unlink()
        raise
    for note in found.notes:
        print(note)
    print(f"{path}: written; its [uncertainty] and what else it says is assumed are yours to change")
    print(f"look it through, then: hil doctor {path}")
    if args.json:
        write_json(args.json, {"file": str(path), "notes": found.notes, "verified_on_hardware": False})
    return 0


# -- CANopen -----------------------------------------------------------------------------------------------------------
def _canopen(args: argparse.Namespace, ask: Answers, notes: DriveNotes | None) -> FirstContact:
    if not args.channel or args.node is None:
        raise InputError(f"--drive {args.drive} needs --channel and --node; hil scan --channel CHANNEL lists the nodes")
    for key in notes.axis_file if notes is not None else ():
        if key.key == "axis" and args.axis is None:  # decides which objects are read
            args.axis = key.value or ask.choose(key)
    axis = 1 if args.axis is None else _whole("--axis", args.axis, 8)
    eds = None if args.eds is None else load_eds(args.eds, args.node)
    clock = WallClock()
    with CanLink.open(clock, interface=args.interface, channel=args.channel, bitrate=args.bitrate) as link:
        found = canopen.scan(link, [args.node], timeout_s=min(args.timeout, 1.0))
        if not found:
            raise NoAnswerError(f"node {args.node} does not answer on {args.channel}; {canopen_nodes(link)}")
        node = found[0]
        if not node.answers_sdo:
            raise NoAnswerError(f"node {args.node} on {args.channel} is heard but does not answer SDO")
        told = [f"node {node.node_id}: {node.device_name or 'no name'}{_identity(node)}"]
        sdo = SdoClient(link, args.node, f"node {args.node}", timeout_s=args.timeout, axis=axis)
        if wrong := _not_this_drive(args, node, notes):
            return FirstContact(None, read_units(sdo), [*told, wrong])
        described = _described(
            args, ask, notes, sdo, (node.vendor_id or 0) if eds is None else eds.maker(node.vendor_id)
        )
    lines = described.lines and [*described.lines, *_simulated(node.device_name or "")]
    return replace(described, lines=lines, notes=[*told, *_file_notes(eds, node), *described.notes])


def _described(
    args: argparse.Namespace, ask: Answers, notes: DriveNotes | None, sdo: SdoClient, vendor: int
) -> FirstContact:
    """The drive's own account of itself, and what its notes add. Writes nothing."""
    told: list[str] = []
    lines = [
        'backend = "canopen"',
        f'interface = "{args.interface}"',
        f'channel = "{args.channel}"',
        f"bitrate = {args.bitrate}",
        f"node_id = {args.node}",
    ]
    if args.eds is not None:
        lines.append(f'eds = "{Path(args.eds).resolve()}"')
    keys = {"axis": args.axis, "velocity_unit": args.velocity_unit, "acceleration_unit": args.acceleration_unit}
    given = {key: value for key, value in keys.items() if value is not None}
    lines += [
        f"axis = {value}" if key == "axis" else f'{key} = "{value}"    # as you gave it' for key, value in given.items()
    ]
    for key in notes.axis_file if notes is not None else ():
        unless = None if key.unless is None else Entry(key.unless, 0, DataType.U32, "")
        if key.key in given or (unless is not None and sdo.read_if_shown(unless, 0)):
            continue
        value = key.value or ask.choose(key)
        given[key.key] = value
        lines.append(f"{key.line(value)}    # {key.source} ({key.strength.value}): {key.why}")
    several = readings(read_units(sdo))
    scaling = ask.scaling(several[0])
    told += _units_told(several, args.drive)
    motion = motion_units(
        partial(sdo.read_if_shown, absent=None),
        scaling,
        velocity=given.get("velocity_unit"),
        acceleration=given.get("acceleration_unit"),
        vendor=vendor,
    )
    if motion.ambiguous:
        remedy = "give it by --velocity-unit, as the drive's manual has it under 6081h"
        return FirstContact(None, several[0], [*told, f"{motion.ambiguous}; {remedy}"])
    told.append(f"velocities in {motion.velocity.text} ({motion.velocity.source}), 1 unit is {motion.mm_s(1):.4g} mm/s")
    modes = sdo.read_if_shown(objects.SUPPORTED_MODES, None)
    homes = not modes or bool(modes & Mode.HOMING.supported_bit)
    method, offset = sdo.read_if_shown(objects.HOMING_METHOD, None), sdo.read_if_shown(objects.HOME_OFFSET, None)
    if homes and method is None:
        told.append("homing: the drive does not say how it homes (6098h); see its manual, and [drive.homing] method")
    elif homes and not method:
        told.append("homing: method 0 (6098h), which homes nothing; set it in the drive, or [drive.homing] method here")
    elif homes:
        told += homing_told(method, None if offset is None else scaling.load_mm(offset))
    else:
        told.append(f"homing: the drive has no homing mode (6502h is {modes:X}h); [measurement] home = false is set")
    more: tuple[str, ...] = ()
    if homes and (not method or method in POSITION_DEPENDENT_METHODS):
        more = (
            "",
            "# [drive.homing]    # without the leading #: written before each homing, put back afterwards",
            "# method = 17       # 17, 18: to the negative, positive limit switch; 19 to 30: to the home switch",
        )
    if notes is not None:
        told += [f"noted of this drive ({fact.strength.value}): {fact.says}" for fact in notes.facts]
    return FirstContact(lines, several[0], told, homes, more)


def _identity(node: canopen.FoundNode) -> str:
    parts = [("vendor", node.vendor_id), ("product", node.product_code)]
    return "".join(f", {name} {number:X}h" for name, number in parts if number is not None)


def _not_this_drive(args: argparse.Namespace, node: canopen.FoundNode, notes: DriveNotes | None) -> str:
    """Why the notes are not of this node's maker, with those that are; "" where nothing speaks against them."""
    expected = None if notes is None else notes.head.vendor_id
    if notes is None or expected is None or not node.vendor_id or node.vendor_id == expected:
        return ""
    others = [name for name, each in shipped_notes().items() if each.head.vendor_id == node.vendor_id]
    what = f"{notes.head.maker} is vendor {expected:X}h, node {args.node} is of {node.vendor_id:X}h"
    return f"{what}: this is no {args.drive}; use --drive {' or '.join([*others, CANOPEN])}"


def _file_notes(eds: EdsFile | None, node: canopen.FoundNode) -> list[str]:
    if eds is None:
        return []
    doubts = eds.doubts(node.vendor_id, node.product_code)
    return [*doubts, *(f"the maker's file: {note}" for note in summary(eds.notes))]


def _units_told(several: tuple[Any, ...], name: str) -> list[str]:
    if len(several) < 2:
        return []
    other = several[1]
    counts, feed = other.position_units_per_shaft_rev, other.feed_mm_per_shaft_rev
    text = (
        f"{float(counts):g} units per turn of the screw" if counts is not None else f"a lead of {float(feed or 0):g} mm"
    )
    return [f"its feed constant (6092h) may also mean {text}: hil doctor tells which, before the axis moves far"]


def _whole(option: str, text: str, highest: int) -> int:
    if not (text.isdecimal() and 1 <= int(text) <= highest):
        raise InputError(f"{option} is {text!r}, expected a whole number 1 to {highest}")
    return int(text)


def _simulated(device_name: str) -> list[str]:
    """The key that certificates read, for a drive that names itself simulated (1008h)."""
    return (
        ["simulated = true    # by the name that the drive gives itself"]
        if device_name.startswith("Simulated ")
        else []
    )


# -- Modbus ------------------------------------------------------------------------------------------------------------
def _modbus(args: argparse.Namespace) -> FirstContact:
    drive = load_drive_map(args.drive)
    unit = drive.registers.bus.unit if args.unit is None else args.unit
    url, endpoint = _endpoint(args, drive)
    clock = WallClock()
    link = ModbusLink(endpoint, clock)
    link.open()
    try:
        access = RegisterAccess(link, unit, drive.registers)
        try:
            raw = access.read((drive.position,))
        except TransportError as error:
            link.close()
            there = modbus_units(endpoint, clock)
            link.open()
            usual = factory(drive)
            raise NoAnswerError(
                f"unit {unit} does not answer on {endpoint} ({error}); {there}; from the factory the drive has {usual}"
            ) from error
        registers = ModbusRawParameters(Path(args.file).stem, ModbusLine(link), unit, drive, access=access)
        notes = [f"position reads {raw[drive.position]} (raw)"]
        fits = _word_order(args, drive, registers, notes)
        fits &= _needs(args, drive, registers, notes)
        reported = registers.reported_scaling()
        device_name = (
            str(NamedParameters(registers).read("device_name")) if "device_name" in drive.registers.registers else ""
        )
        if drive.homing is None:
            notes.append(f"homing: {drive.without_homing or 'not described'}; [measurement] home = false is set")
        elif drive.homing.method is not None:
            notes += _homing_by_register(drive, access)
    finally:
        link.close()
    weak = sum(len(each) for each in drive.weak().values())
    if weak:
        notes.append(f"{weak} facts of the drive file are assumed; hil doctor proves them before the axis is used")
    name = args.drive if args.drive in shipped_maps() else str(find_map(args.drive).resolve())
    lines = ['backend = "modbus"', f'register_map = "{name}"', f'url = "{url}"', f"unit = {unit}"]
    if isinstance(endpoint, RtuEndpoint):
        lines.append(f"baud = {endpoint.baud}")
    lines += _simulated(device_name)
    return FirstContact(lines if fits else None, reported, notes, drive.homing is not None)


def _endpoint(args: argparse.Namespace, drive: DriveMap) -> tuple[str, Endpoint]:
    bus = drive.registers.bus
    if args.tcp is not None:
        place = args.tcp if ":" in args.tcp else f"{args.tcp}:{bus.port or 502}"
        url = f"tcp://{place}?timeout_s={args.timeout:g}"
    elif args.serial is not None:
        more = "&" if "?" in args.serial else "?"
        url = f"{args.serial}{more}timeout_s={args.timeout:g}"
        if "parity" not in url:
            url += f"&parity={bus.parity}&stop_bits={bus.stop_bits}"
    else:
        raise InputError(f"--drive {args.drive} needs --tcp or --serial; hil scan finds the drive ({factory(drive)})")
    return url, parse_endpoint(url, baud=args.baud or bus.baud)


def _word_order(args: argparse.Namespace, drive: DriveMap, registers: ModbusRawParameters, notes: list[str]) -> bool:
    """By a value that the drive's display shows, else by the values found."""
    if args.known is None:
        names = [name for name in drive.wide() if drive.registers[name].readable]
        words = registers.access.words(names)
        verdict = judge_orders({name: (drive.registers[name], words[name]) for name in names})
        notes.append(f"word order: {verdict.detail}")
        return verdict.agrees
    name, equals, text = args.known.partition("=")
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not equals or not math.isfinite(value):
        raise InputError(f"--known is {args.known!r}, expected REGISTER=VALUE")
    layout = drive.registers[name].layout
    matches = registers.probe_order(name, value, tolerance=args.tolerance)
    if any(match.offset == 0 and match.layout == layout for match in matches):
        notes.append(f"word order: {name} reads {text} as the drive file says")
        return True
    fits = [
        f"word order {m.layout.word_order.value} at offset {m.offset:+d}"
        for m in matches
        if m.layout.type is layout.type
    ]
    hint = f"it fits {' or '.join(fits)}: copy the drive file and change it" if fits else "it is in no order there"
    notes.append(f"word order: {name} does not read {text} as the drive file says; {hint}")
    return False


def _needs(args: argparse.Namespace, drive: DriveMap, registers: ModbusRawParameters, notes: list[str]) -> bool:
    """Whether everything holds that only the user may change; with --set-up it is written, by name and read back."""
    good = True
    for need in drive.needs:
        name = need.condition.register
        raw = registers.access.integers([name])[name]
        if all_hold((need.condition,), {name: raw}) or need.write is not None:
            continue
        text = f"{name} reads {raw:#x}, expected {wanted(need)}: {need.why}"
        mask, value = need.condition.mask, need.condition.values[0]
        if args.set_up and not need.condition.negate:
            NamedParameters(registers).write(name, value if mask is None else (raw & ~mask) | value)
            notes.append(f"{text}; written (it was {raw:#x})")
            continue
        notes.append(f"{text}; {need.remedy}")
        good = False
    return good


def _homing_by_register(drive: DriveMap, access: RegisterAccess) -> list[str]:
    homing = drive.homing
    if homing is None or homing.method is None:
        return []
    method = int(access.read((homing.method,))[homing.method])
    if not homing.makers_method:
        return homing_told(method, None)
    register = drive.registers[homing.method]
    told = f"homing method {method}, by the maker's own numbers ({register.description or register.name}):"
    return [
        f"{told} its manual says what it seeks and where zero will be; one that takes the place where it stands loses its zero"
    ]


def homing_told(method: int | None, home_position_mm: float | None) -> list[str]:
    """What the drive's homing does, where zero will be, and its risk."""
    explained = explain_homing(method, home_position_mm)
    notes = [f"homing method {method}, {explained}"] if explained else []
    risk = homing_risk(True, method) if method is not None else None
    return [*notes, f"RISK of homing: {risk}"] if risk else notes
