"""`hil drives list` and `show`: register maps and notes, with the source and strength of each statement."""

from __future__ import annotations

import argparse
from typing import Any

from drivers.drive_notes import DriveNotes, DriveWire, shipped_notes
from drivers.modbus.drive_map import DriveMap, Need
from drivers.modbus.map_facts import Origin
from drivers.modbus.map_loader import load_drive_map
from drivers.modbus.register_map import Register, find_map, shipped_maps
from hil.files.first_axis_file import CANOPEN
from hil.ui.terminal.output import Align, print_facts, print_table, write_json

"""Name of the drive file of every CiA-402 drive on CANopen, which describes itself."""
_STRENGTHS = (
    "strength: maker, run (ran on the drive), notes (from the manual), assumed, general (knowledge without a source);"
)


def list_drives(args: argparse.Namespace) -> int:
    rows, form = [], []
    for name in sorted(shipped_maps()):
        drive = load_drive_map(name)
        registers = drive.registers
        weak = sum(len(each) for each in drive.weak().values())
        wire = "Modbus TCP" if registers.bus.port else "Modbus"
        form.append(
            {
                "name": name,
                "wire": wire,
                "description": registers.description,
                "source": registers.origin.source,
                "to_be_proven": weak,
                "homes": drive.homing is not None,
                "verified_on_hardware": registers.origin.verified_on_hardware,
            }
        )
        seen = "yes" if registers.origin.verified_on_hardware else "no"
        homes = "yes" if drive.homing is not None else "no"
        rows.append([name, wire, registers.description, f"{weak} facts" if weak else "–", homes, seen])
    rows.append(
        [CANOPEN, "CANopen", "any CiA-402 drive; it describes itself (1018h, 608Fh, 6091h, 6092h)", "–", "yes", "no"]
    )
    left: Align = "left"
    print_table(
        ["name", ("wire", left), ("drive", left), "doctor proves", ("homes", left), ("verified on hardware", left)],
        rows,
    )
    notes = shipped_notes()
    with_file = {name: each for name, each in notes.items() if not each.head.no_file}
    print_table(
        ["notes on drives", ("drive", left), "statements", ("weakest", left), ("asked by `new`", left)],
        [_notes_row(name, each) for name, each in with_file.items()],
    )
    print_table(
        ["no drive file", ("drive", left), ("because", left)],
        [[name, each.head.description, each.head.no_file] for name, each in notes.items() if each.head.no_file],
    )
    if args.json:
        write_json(args.json, {"drives": form, "notes": {name: _notes_form(each) for name, each in notes.items()}})
    return 0


def _notes_row(name: str, notes: DriveNotes) -> list[str]:
    weak = sum(fact.strength.is_weak for fact in notes.facts)
    asked = ", ".join(key.option for key in notes.axis_file if key.value is None)
    return [
        name,
        notes.head.description,
        str(len(notes.facts)),
        f"{weak} assumed or general" if weak else "–",
        asked or "–",
    ]


def _notes_form(notes: DriveNotes) -> dict[str, Any]:
    head = notes.head
    return {
        "wire": head.wire.value,
        "description": head.description,
        "source": head.source,
        "revision": head.revision,
        "verified_on_hardware": head.verified_on_hardware,
        "no_file": head.no_file,
        "facts": [{**vars(fact), "topic": fact.topic.value, "strength": fact.strength.value} for fact in notes.facts],
        "axis_file": [
            {"key": key.key, "value": key.value, "choices": list(key.choices), "strength": key.strength.value}
            for key in notes.axis_file
        ],
    }


def _show_notes(args: argparse.Namespace, notes: DriveNotes) -> int:
    head = notes.head
    facts = {"drive": head.description, "wire": head.wire.value, "source": head.source, "revision": head.revision}
    facts["verified on hardware"] = "yes" if head.verified_on_hardware else "no"
    if head.vendor_id is not None:
        facts["vendor (1018h:1)"] = f"{head.vendor_id:X}h"
    if head.no_file:
        facts["no drive file"] = head.no_file
    print_facts(facts)
    left: Align = "left"
    columns: list[str | tuple[str, Align]] = [
        "about",
        ("says", left),
        ("strength", left),
        ("source", left),
        ("what hil does", left),
    ]
    print_table(
        columns,
        [[fact.topic.value, fact.says, fact.strength.value, fact.source, fact.does or "–"] for fact in notes.facts],
        title="statements",
    )
    if notes.axis_file:
        print_table(
            ["axis file", ("value", left), ("why", left), ("strength", left), ("source", left)],
            [
                [
                    key.key,
                    key.value or f"you choose: {' or '.join(key.choices)}",
                    key.why,
                    key.strength.value,
                    key.source,
                ]
                for key in notes.axis_file
            ],
        )
    print(f"{_STRENGTHS} none of it is taken for granted:")
    print("the drive is asked what it has, and `hil doctor` proves its units before anything else is done")
    if head.wire is DriveWire.CANOPEN and not head.no_file:
        print(f"first axis file: hil drives new X.toml --drive {args.name} --channel can0 --node ID")
    if args.json:
        write_json(args.json, {"name": args.name, **_notes_form(notes)})
    return 0


def show_drive(args: argparse.Namespace) -> int:
    if args.name == CANOPEN:
        print("a CiA-402 drive describes itself; `hil drives new --drive canopen` reads it, `hil doctor` proves it")
        return 0
    notes = shipped_notes()
    if args.name in notes:
        return _show_notes(args, notes[args.name])
    drive = load_drive_map(args.name)
    registers, origin = drive.registers, drive.registers.origin
    print_facts(
        {
            "drive": registers.description,
            "file": str(find_map(args.name)),
            "source": origin.source,
            "revision": origin.revision,
            "verified on hardware": "yes" if origin.verified_on_hardware else "no",
            "from the factory": factory(drive),
            "homing": drive.without_homing or ("by the drive" if drive.homing is not None else "not described"),
        }
    )
    rows = [
        [name, f"{each.span.start:#06x}", each.layout.type.value, each.unit, *_origin(each, origin)]
        for name, each in registers.registers.items()
    ]
    left: Align = "left"
    columns: list[str | tuple[str, Align]] = [
        "register",
        ("address", left),
        ("type", left),
        ("unit", left),
        ("strength", left),
        ("source", left),
    ]
    print_table(columns, rows, title="registers (0-based addresses)")
    if registers.facts:
        facts = [
            [each.about, each.says, each.strength.value, each.proof.value, each.source] for each in registers.facts
        ]
        columns = ["about", ("says", left), ("strength", left), ("proven by", left), ("source", left)]
        print_table(columns, facts, title="facts")
    if drive.needs:
        needs = [
            [one.condition.register, wanted(one), "you" if one.write is None else "hil, while enabled", one.why]
            for one in drive.needs
        ]
        print_table(["needs", ("value", left), ("set by", left), ("why", left)], needs)
    print(_STRENGTHS)
    print("the last two are used only after `hil doctor` has proven them on your drive")
    if args.json:
        write_json(args.json, _form(drive))
    return 0


def _form(drive: DriveMap) -> dict[str, Any]:
    registers = drive.registers
    return {
        "name": registers.name,
        "verified_on_hardware": registers.origin.verified_on_hardware,
        "registers": {
            name: {"address": each.span.start, "strength": each.origin.strength.value, "source": each.origin.source}
            for name, each in registers.registers.items()
        },
        "facts": [
            {**vars(each), "strength": each.strength.value, "proof": each.proof.value} for each in registers.facts
        ],
        "to_be_proven": {proof.value: list(texts) for proof, texts in drive.weak().items()},
    }


def factory(drive: DriveMap) -> str:
    """How the drive's bus is set up from the factory."""
    bus = drive.registers.bus
    line = f"port {bus.port}" if bus.port else f"{bus.baud} 8{bus.parity}{bus.stop_bits}"
    return f"{line}, unit {bus.unit}" + (f"; {bus.note}" if bus.note else "")


def _origin(register: Register, usual: Origin) -> tuple[str, str]:
    """Strength and source of a register; a dash where the source is the file's."""
    own = register.origin
    return own.strength.value, "–" if own.source == usual.source else own.source


def wanted(need: Need) -> str:
    """The values that a need accepts."""
    text = " or ".join(f"{value:#x}" for value in need.condition.values)
    return f"not {text}" if need.condition.negate else text
