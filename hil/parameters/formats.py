"""Reading and writing a set as TOML, DCF or concise DCF, chosen by the file's suffix.

A DCF needs the maker's EDS. A concise DCF names neither drive nor parameters; the names come from the drive's own file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from drivers.canopen.dcf import pack_concise, render_dcf, unpack_concise
from drivers.canopen.eds import EdsFile, Key, load_eds
from drivers.canopen.pdo import EXISTS_NOT, pdo_of
from drivers.canopen.whole_pdo import PdoImage, pdo_at, wholes
from drivers.errors import InputError
from drivers.files import read_bytes, replace_file
from drivers.raw_parameters import DriveIdentity, RawParameters
from hil.parameters import FORMATS
from hil.parameters.preflight import match_set
from hil.parameters.set_file import ParameterSet, SetEntry, object_address, object_key, read_set, write_set
from hil.records.files import naming


def format_of(path: Path) -> str:
    """The form by the suffix; toml for any other suffix."""
    suffix = path.suffix.lower().removeprefix(".")
    return suffix if suffix in FORMATS else "toml"


def read_any(path: str | Path, node_id: int | None = None, *, pdos: bool = True) -> ParameterSet:
    """Read a set of any form. node_id: the drive's, for $NODEID in a DCF, else the DCF's own; pdos: of a DCF or concise DCF, take each
    PDO as a whole, else leave PDOs out.

    Raises InputError naming the file; also for a DCF of another node whose PDOs carry that node's COB-IDs.
    """
    path = Path(path)
    form = format_of(path)
    if form == "dcf":
        return _read_dcf(path, node_id, pdos)
    if form == "cdcf":
        with naming(path):
            objects = unpack_concise(read_bytes(path))
        # repeated in order (disabled, filled, enabled): what a device holds at the end is its last value
        last = {key: SetEntry(object_address(*key), None, data.hex()) for key, data in _in_last_order(objects).items()}
        return ParameterSet(path.name, None, _with_pdos(last, objects, pdos), None, path, foreign=True)
    return read_set(path)


def _in_last_order(objects: Sequence[tuple[Key, bytes]]) -> dict[Key, bytes]:
    """Each object once, in the place and with the value of its last occurrence."""
    last: dict[Key, bytes] = {}
    for key, data in objects:
        last.pop(key, None)
        last[key] = data
    return last


def _with_pdos(
    entries: Mapping[Key, SetEntry], objects: Sequence[tuple[Key, bytes]], pdos: bool
) -> tuple[SetEntry, ...]:
    """The entries with those of each PDO taken together at the end. pdos False: as they are, so that they are left out and listed."""
    if not pdos:
        return tuple(entries.values())
    found = wholes(objects)
    singles = [entry for key, entry in entries.items() if pdo_of(key[0]) is None]
    together = [SetEntry(pdo.address, None, block.pack().hex(), "PDO", "", pdo.name) for pdo, block in found.items()]
    return (*singles, *together)


def _read_dcf(path: Path, node_id: int | None, pdos: bool) -> ParameterSet:
    """The set of a DCF: objects with a ParameterValue. Raises InputError for a DCF without any."""
    dcf = load_eds(path, node_id)
    found = {key: each for key, each in sorted(dcf.entries.items()) if each.value is not None and each.writable}
    if not found:
        raise InputError("configures nothing, expected objects with a ParameterValue", path=path)
    entries = {
        key: SetEntry(
            object_address(*key),
            each.value.hex() if isinstance(each.value, bytes) else each.value,
            None,
            each.entry.type.name,
            "",
            each.entry.name,
        )
        for key, each in found.items()
    }
    objects = [(key, each.entry.pack(each.value)) for key, each in found.items() if each.value is not None]
    if pdos:
        _refuse_pdos_of_another_node(dcf, objects, node_id, path)
    given = {
        "vendor_id": dcf.vendor_number or next(iter(dcf.vendors()), 0),
        "product_code": dcf.product_number or next(iter(dcf.products()), 0),
    }
    model = {name: value for name, value in given.items() if value}
    identity = DriveIdentity("canopen", model)
    return ParameterSet(path.name, identity, _with_pdos(entries, objects, pdos), None, path, foreign=True)


def _refuse_pdos_of_another_node(
    dcf: EdsFile, objects: Sequence[tuple[Key, bytes]], node_id: int | None, path: Path
) -> None:
    """Raises InputError where the DCF is of another node, and a PDO in use carries a COB-ID of that node's predefined set."""
    if node_id is None or dcf.node_id in (None, node_id):
        return
    for pdo, block in wholes(objects).items():
        cob_id = block.cob_id
        if cob_id is not None and not cob_id & EXISTS_NOT and cob_id & 0x7F == dcf.node_id:
            raise InputError(
                f"is of node {dcf.node_id}, and its {pdo.name} has the COB-ID {cob_id & 0x7FF:03X}h of that node; this drive is"
                f" node {node_id}: --without-pdos leaves the PDOs out",
                path=path,
            )


def write_any(path: Path, contents: ParameterSet, drive: RawParameters, form: str | None, eds: Path | None) -> None:
    """Write a set in a form (None: by the file's suffix). eds: the maker's file, on which a DCF is based.

    Raises InputError where the form cannot hold the set, a DCF has no EDS, or the file cannot be written.
    """
    form = form or format_of(path)
    if form == "toml":
        write_set(path, contents)
        return
    wanted, objections = match_set(drive, contents)
    unknown = [objection for objection in objections if objection.address not in drive.entries]
    if unknown:
        raise InputError(f"cannot be written as {form}: {unknown[0]}", path=path)
    values: list[tuple[Key, bytes]] = []
    for each in wanted:
        if pdo_at(each.address) is not None:
            values += PdoImage.unpack(each.data).items
            continue
        key = object_key(each.address)
        if key is None:
            raise InputError(f"cannot be written as {form}: {each.address} is no CANopen object", path=path)
        values.append((key, each.data))
    if form == "cdcf":
        replace_file(path, pack_concise(values))
        return
    if eds is None:
        raise InputError("cannot be written as DCF: the axis file names no eds", path=path)
    model = {} if contents.identity is None else contents.identity.model
    replace_file(path, render_dcf(eds, values, getattr(drive, "node_id", None), model=model).encode())
