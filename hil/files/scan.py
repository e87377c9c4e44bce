"""`hil scan`: lists the nodes of a CAN bus or the units of a Modbus line. Reads only; needs no axis file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from enum import Enum
from typing import Any

from drivers.canopen import scan as canopen
from drivers.canopen.bus import CanLink
from drivers.canopen.identity import PROFILE
from drivers.clock import WallClock
from drivers.drive_notes import shipped_notes
from drivers.errors import InputError
from drivers.modbus import scan as modbus
from drivers.modbus.endpoint import Endpoint, RtuEndpoint, TcpEndpoint, parse_endpoint
from drivers.modbus.link import ModbusLink
from drivers.modbus.map_loader import load_drive_map
from hil.machine.events import Event
from hil.ui.terminal.output import Align, print_table, write_json
from hil.ui.terminal.progress import terminal_progress


def run(args: argparse.Namespace) -> int:
    """Exit status 0: a device was found; 1: none. Raises InputError for an option out of range."""
    if args.timeout is not None and not 0.001 <= args.timeout <= 60.0:
        raise InputError(f"--timeout is {args.timeout:g}, expected 0.001 to 60 s")
    found: Sequence[Any] = _canopen(args) if args.channel else _modbus(args)
    if not found:
        print("no device answers")
    else:
        print(f"next: hil drives new X.toml --drive {_drive_option(args, found)}, then hil doctor X.toml")
        if args.channel and (noted := _noted(found)):
            print(f"notes on drives of these makers: hil drives show {' | '.join(noted)}")
    if args.json:
        kind = "nodes" if args.channel else "units"
        write_json(args.json, {kind: [_plain(vars(each)) for each in found]})
    return 0 if found else 1


def _noted(found: Sequence[canopen.FoundNode]) -> list[str]:
    """Names of the notes on drives of the makers that were found."""
    vendors = {node.vendor_id for node in found if node.vendor_id}
    return [name for name, notes in shipped_notes().items() if notes.head.vendor_id in vendors]


def _drive_option(args: argparse.Namespace, found: Sequence[Any]) -> str:
    """The options of `hil drives new` for the first device."""
    if args.channel:
        drives = (
            [node for node in found if node.profile == PROFILE] or [node for node in found if node.answers_sdo] or found
        )
        rate = "" if args.bitrate is None else f" --bitrate {args.bitrate}"
        return f"canopen --interface {args.interface} --channel {args.channel}{rate} --node {drives[0].node_id}"
    where = f"--tcp {args.tcp}" if args.tcp else f'--serial "{args.serial}" --baud {args.baud}'
    return f"{args.map or 'NAME (hil drives list)'} {where} --unit {found[0].unit}"


# -- CANopen -----------------------------------------------------------------------------------------------------------
def _canopen(args: argparse.Namespace) -> list[canopen.FoundNode]:
    nodes = parse_ids(args.nodes, "--nodes", 1, 127)
    if args.listen is not None and not 0 < args.listen <= 3600:
        raise InputError(f"--listen is {args.listen:g}, expected 0 to 3600 s")
    clock = WallClock()
    with CanLink.open(clock, interface=args.interface, channel=args.channel, bitrate=args.bitrate) as link:
        if args.listen is not None:
            found = canopen.listen(link, args.listen)
        else:
            with terminal_progress() as listener:
                found = canopen.scan(
                    link,
                    nodes,
                    timeout_s=0.1 if args.timeout is None else args.timeout,
                    progress=lambda done: listener(Event("nodes", "", done, len(nodes))),
                )
    if found:
        columns: list[str | tuple[str, Align]] = [
            "node",
            ("NMT", "left"),
            ("device", "left"),
            ("identity", "left"),
            ("drive", "left"),
            ("heard", "left"),
        ]
        print_table(columns, [_node_row(node) for node in found])
    return found


def _node_row(node: canopen.FoundNode) -> tuple[str, ...]:
    nmt = "" if node.nmt_state is None else node.nmt_state.name.lower().replace("_", "-")
    profile = "" if node.profile is None else f"profile {node.profile}"
    device = ", ".join(part for part in (node.device_name, profile) if part)
    if not node.answers_sdo:
        device = node.problem or "does not answer SDO"
    identity = ":".join(
        "–" if number is None else f"{number:X}h"
        for number in (node.vendor_id, node.product_code, node.revision, node.serial)
    )
    drive = []
    if node.state is not None:
        drive.append(f"{node.state.value} ({node.statusword:04X}h)")
    if node.fault_code:
        drive.append(f"error {node.fault_code:04X}h")
    if node.position_counts is not None:
        drive.append(f"at {node.position_counts} counts")
    return str(node.node_id), nmt, device, identity if node.answers_sdo else "", ", ".join(drive), ", ".join(node.heard)


# -- Modbus ------------------------------------------------------------------------------------------------------------
def _modbus(args: argparse.Namespace) -> list[modbus.FoundUnit]:
    endpoint = _endpoint(args)
    highest = 255 if isinstance(endpoint, TcpEndpoint) else 247
    units = parse_ids(args.units, "--units", 0 if isinstance(endpoint, TcpEndpoint) else 1, highest)
    drive_map = None if args.map is None else load_drive_map(args.map)
    link = ModbusLink(endpoint, WallClock(), policy=modbus.POLICY)
    link.open()
    try:
        with terminal_progress() as listener:
            found = modbus.scan(
                link, units, drive_map, progress=lambda done: listener(Event("units", "", done, len(units)))
            )
    finally:
        link.close()
    if found:
        print_table(("unit", ("answers", "left"), ("drive", "left")), [_unit_row(unit) for unit in found])
    for unit in found:
        if unit.also:
            print(f"unit {unit.unit} answered when unit {listed_ids(unit.also)} was asked: give unit = {unit.unit}")
    if len(found) == len(units) > 1 and isinstance(endpoint, TcpEndpoint):
        print("every unit id is answered: this server does not look at it, and is one device")
    return found


def _endpoint(args: argparse.Namespace) -> Endpoint:
    timeout_s = 0.2 if args.timeout is None else args.timeout
    if args.tcp is not None:
        endpoint = parse_endpoint(args.tcp if "//" in args.tcp else f"tcp://{args.tcp}")
        if not isinstance(endpoint, TcpEndpoint):
            raise InputError(f"--tcp is {args.tcp!r}, expected host or host:port")
        return TcpEndpoint(endpoint.host, endpoint.port, timeout_s)
    line = parse_endpoint(args.serial, baud=args.baud)
    if not isinstance(line, RtuEndpoint):
        raise InputError(f"--serial is {args.serial!r}, expected a device")
    return RtuEndpoint(line.device, line.baud, line.parity, line.stop_bits, timeout_s)


def _unit_row(unit: modbus.FoundUnit) -> tuple[str, ...]:
    drive = [] if unit.state is None else [unit.state.value, f"position {unit.position_raw} (raw)"]
    if unit.fault_code:
        drive.append(f"error {unit.fault_code}")
    if unit.problem:
        drive.append(unit.problem)
    return str(unit.unit), unit.refusal or "registers", ", ".join(drive)


# -- shared ------------------------------------------------------------------------------------------------------------
def parse_ids(text: str, option: str, lowest: int, highest: int) -> list[int]:
    """`1-5,9` -> [1, 2, 3, 4, 5, 9]. Raises InputError naming the option."""
    ids: set[int] = set()
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        try:
            start, end = int(first), int(last) if dash else int(first)
        except ValueError as error:
            raise InputError(f"{option} is {text!r}, expected ids such as 1-16,20") from error
        if not lowest <= start <= end <= highest:
            raise InputError(f"{option} is {text!r}, expected ids {lowest} to {highest}, ranges ascending")
        ids.update(range(start, end + 1))
    return sorted(ids)


def listed_ids(ids: Sequence[int]) -> str:
    """[1, 2, 3, 5] -> `1-3,5`."""
    firsts = [each for each in ids if each - 1 not in ids]
    lasts = [each for each in ids if each + 1 not in ids]
    return ",".join(
        str(first) if first == last else f"{first}-{last}" for first, last in zip(firsts, lasts, strict=True)
    )


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Enumerations by their names, everything else as it is."""
    return {name: _name(value) if isinstance(value, Enum) else value for name, value in values.items()}


def _name(value: Enum) -> str:
    return value.value if isinstance(value.value, str) else value.name.lower()
