"""The files with sets of parameters that an axis has at hand: in its folder, and brought by a browser."""

from __future__ import annotations

import re
from pathlib import Path

from drivers.errors import InputError
from hil.axis.axis_file import DriveAxis
from hil.parameters.formats import FORMATS, read_any
from hil.parameters.set_file import FORMAT
from hil.records.files import read_bytes, replace_file

LARGEST_BYTES = 2_000_000
_HEAD_BYTES = 4096
_NAME = re.compile(r"[\w][\w .+-]{0,99}")


def set_files(axis: DriveAxis) -> tuple[Path, ...]:
    """Sets in the axis file's folder and among the brought ones, by name. Whether they are whole is seen when one is read."""
    found = [path for folder in (_folder(axis), _brought(axis)) if folder.is_dir() for path in folder.iterdir()]
    return tuple(sorted((path for path in found if _is_set(path)), key=lambda path: path.name))


def keep_set(axis: DriveAxis, name: str, data: bytes) -> Path:
    """Keep a set that was brought. Raises InputError for what is no set, too large, or another than the one of that name."""
    name = Path(name).name
    if not _NAME.fullmatch(name) or Path(name).suffix.lower().removeprefix(".") not in FORMATS:
        raise InputError(f"{name!r}: expected the name of a set, ending in {', '.join(f'.{one}' for one in FORMATS)}")
    require_size(name, len(data))
    path, new = _brought(axis) / name, _brought(axis) / f".new-{name}"
    if path.exists():
        if read_bytes(path) != data:
            raise InputError("is there already and holds something else: expected another name", path=path)
        return path
    new.parent.mkdir(parents=True, exist_ok=True)
    replace_file(new, data)
    try:
        read_any(new)
        new.replace(path)
    finally:
        new.unlink(missing_ok=True)
    return path


def require_size(name: str, size_bytes: int) -> None:
    """Before anything is read of it. Raises InputError for a file that is too large for a set."""
    if size_bytes > LARGEST_BYTES:
        raise InputError(f"{Path(name).name} has {size_bytes} bytes, expected at most {LARGEST_BYTES}")


def _folder(axis: DriveAxis) -> Path:
    return axis.path.resolve().parent


def _brought(axis: DriveAxis) -> Path:
    return axis.store.directory / "parameters" / "sets"


def _is_set(path: Path) -> bool:
    """By its name, and of TOML by its first lines: axis files are TOML too."""
    if path.name.startswith(".") or not path.is_file():
        return False
    suffix = path.suffix.lower()
    if suffix != ".toml":
        return suffix.removeprefix(".") in FORMATS
    with path.open("rb") as file:
        return FORMAT.encode() in file.read(_HEAD_BYTES)
