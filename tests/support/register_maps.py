"""Registers alone, of a map without a drive."""

from __future__ import annotations

from pathlib import Path

from drivers.modbus.register_map import RegisterMap, parse_registers
from drivers.toml_schema import Document


def load_register_map(path: Path) -> RegisterMap:
    document = Document.read(path)
    registers = parse_registers(document)
    document.finish()
    return registers
