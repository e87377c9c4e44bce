"""Reading and writing a set as TOML, DCF or concise DCF, chosen by the file's suffix.

A DCF needs the maker's EDS. A concise DCF names neither drive nor parameters; the names come from the drive's own file.
"""

from __future__ import annotations

from pathlib import Path

from drivers.canopen.dcf import pack_concise, render_dcf, unpack_concise
from drivers.canopen.eds import load_eds
from drivers.errors import InputError
from drivers.raw_parameters import DriveIdentity, RawParameters
from hil.parameters.preflight import match_set
from hil.parameters.set_file import ParameterSet, SetEntry, object_address, object_key, read_set, write_set
from hil.records.files import naming, read_bytes, replace_file

FORMATS = ("toml", "dcf", "cdcf")


def format_of(path: Path) -> str:
    """The form by the suffix; toml for any other suffix."""
    suffix = path.suffix.lower().removeprefix(".")
    return suffix if suffix in FORMATS else "toml"


def read_any(path: str | Path) -> ParameterSet:
    """Read a set of any form. Raises InputError naming the file."""
    path = Path(path)
    form = format_of(path)
    if form == "dcf":
        return _read_dcf(path)
    if form == "cdcf":
        with naming(path):
            objects = unpack_concise(read_bytes(path))
        entries = tuple(SetEntry(object_address(*key), None, data.hex()) for key, data in objects)
        return ParameterSet(path.name, None, entries, None, path)
    return read_set(path)


def _read_dcf(path: Path) -> ParameterSet:
    """The set of a DCF: objects with a ParameterValue. Raises InputError for a DCF without any."""
    dcf = load_eds(path)
    entries = tuple(
        SetEntry(object_address(*key), found.value, None, found.entry.type.name, "", found.entry.name)
        for key, found in sorted(dcf.entries.items())
        if found.value is not None and found.writable
    )
    if not entries:
        raise InputError("configures nothing, expected objects with a ParameterValue", path=path)
    given = {"vendor_id": dcf.vendor_number, "product_code": dcf.product_number}
    model = {name: value for name, value in given.items() if value is not None}
    return ParameterSet(path.name, DriveIdentity("canopen", model), entries, None, path)


def write_any(path: Path, contents: ParameterSet, drive: RawParameters, form: str | None, eds: Path | None) -> None:
    """Write a set in a form (None: by the file's suffix). eds: the maker's file, on which a DCF is based.

    Raises InputError where the form cannot hold the set, a DCF has no EDS, or the file cannot be written.
    """
    form = form or format_of(path)
    if form == "toml":
        write_set(path, contents)
        return
    wanted, objections = match_set(drive, contents)
    if objections and any(objection.address not in drive.entries for objection in objections):
        raise InputError(f"cannot be written as {form}: {objections[0]}", path=path)
    values = []
    for each in wanted:
        key = object_key(each.address)
        if key is None:
            raise InputError(f"cannot be written as {form}: {each.address} is no CANopen object", path=path)
        values.append((key, each.data))
    if form == "cdcf":
        replace_file(path, pack_concise(values))
        return
    if eds is None:
        raise InputError("cannot be written as DCF: the axis file names no eds", path=path)
    replace_file(path, render_dcf(eds, values, getattr(drive, "node_id", None)).encode())
