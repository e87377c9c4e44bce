"""Files from outside are read up to a bound, so that a sparse one or a device takes no memory, and as text in each encoding that
editors write; files of ours are replaced in one step, so that a reader or a power cut finds the old bytes or the new ones.
"""

from __future__ import annotations

import codecs
import os
import re
import stat
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from importlib import resources
from pathlib import Path

from drivers.errors import InputError

MOST_BYTES = 1 << 28
"""Longest file without a bound of its own: a million rows of 15 columns take half of it."""


def shipped(package: str, folder: str) -> dict[str, Path]:
    """The TOML files that come with a package, by name."""
    items = (Path(str(item)) for item in (resources.files(package) / folder).iterdir())
    return {path.stem: path for path in items if path.suffix == ".toml"}


def named_file(name_or_path: str | Path, shipped_files: Mapping[str, Path], what: str) -> Path:
    """A file that exists, or one of the shipped files by name. Raises InputError naming them."""
    path = Path(name_or_path)
    if path.is_file():
        return path
    if str(name_or_path) in shipped_files:
        return shipped_files[str(name_or_path)]
    raise InputError(f"is neither a file nor a shipped {what} ({', '.join(sorted(shipped_files))})", path=path)


def read_bytes(path: str | Path, most: int = MOST_BYTES) -> bytes:
    """The bytes of a file. Raises InputError naming it when it cannot be read, or is longer than `most` bytes."""
    try:
        with Path(path).open("rb") as file:
            about = os.fstat(file.fileno())
            # of a device or a pipe the size is not known before
            data = b"" if about.st_size > most else file.read(-1 if stat.S_ISREG(about.st_mode) else most + 1)
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path=path) from error
    except ValueError as error:  # a NUL in the name
        raise InputError(f"cannot be read: {error}", path=path) from error
    if max(len(data), about.st_size) > most:
        raise InputError(f"is too long, expected at most {most >> 10} KiB", path=path)
    return data


_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16, whose mark it begins with
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
"""Byte-order mark -> codec that reads it and what follows."""
_OTHER_FORMS = {
    b"PK\x03\x04": "a ZIP archive, as XLSX, ODS and DOCX files are",
    b"\xd0\xcf\x11\xe0": "an office file of the older form (XLS, DOC)",
    b"%PDF-": "a PDF file",
    b"{\\rtf": "an RTF document",
    b"\x1f\x8b": "a gzip archive",
    b"7z\xbc\xaf\x27\x1c": "a 7z archive",
    b"Rar!": "a RAR archive",
    b"SQLite format 3\0": "an SQLite database",
    b"\x89PNG": "a PNG picture",
    b"\xff\xd8\xff": "a JPEG picture",
}
"""First bytes of files that are not read, and what they are."""
_XML = re.compile(r"\s*+<(\?xml\b|!--|!doctype (?!html)|[\w:.-]+\s[^<>]{0,999}\bxmlns)", re.IGNORECASE)
_HTML = re.compile(r"\s*+<(!doctype html|html)\b", re.IGNORECASE)


def encoding_of(begin: bytes) -> str:
    """The codec of text that begins with these bytes, by its byte-order mark; UTF-8 without one. It takes the mark off."""
    return next((codec for mark, codec in _MARKS.items() if begin.startswith(mark)), "utf-8")


def read_text(path: str | Path, most: int = MOST_BYTES, *, older: bool = False, expected: str = "plain text") -> str:
    """The text of a file of at most `most` bytes; otherwise as `decode_text`."""
    return decode_text(read_bytes(path, most), path, older=older, expected=expected)


def decode_text(
    data: bytes, path: str | Path | None = None, *, older: bool = False, expected: str = "plain text"
) -> str:
    """The text of UTF-8, and of UTF-16 and UTF-32 with their mark, without the mark.

    older: whether bytes that are not UTF-8 are read as Windows-1252 or Latin-1, as older programs write them. Raises InputError, with
    the line where there is one, for other bytes, and for a file of a form that is known and not read: it is named, as is what was
    `expected`.
    """
    for begin, form in _OTHER_FORMS.items():
        if data.startswith(begin):
            raise InputError(f"is {form}, expected {expected}; export it in that form", path=path)
    codec = encoding_of(data)
    if codec == "utf-8" and (data[:1] == b"\0") != (data[1:2] == b"\0"):
        raise InputError(
            f"is UTF-16 without its byte-order mark (every second byte is zero), expected {expected}; save it as UTF-8",
            path=path,
        )
    try:
        text = data.decode(codec)
    except UnicodeDecodeError as error:
        if older and codec == "utf-8" and b"\0" not in data:
            return _older(data)
        at = len(data) - len(error.object) + error.start
        line = data[:at].decode(codec, "replace").count("\n") + 1
        name = codec.removesuffix("-sig").upper()
        raise InputError(f"byte {data[at]:02X}h is not {name} text", path=path, line=line) from error
    text = text.lstrip("\ufeff")  # programs that append to a file, or convert it, write a second mark
    for form, pattern in (("XML, as XDD, XDC, ESI and spreadsheet files are", _XML), ("an HTML page", _HTML)):
        if pattern.match(text):
            raise InputError(f"is {form}, expected {expected}; export it in that form", path=path)
    return text


def decode_log(data: bytes) -> str:
    """The text of a log in UTF-8 whose last line may be torn: what is none is replaced."""
    return data.decode("utf-8-sig", "replace")


SEPARATOR = re.compile(r'"?sep=(.?)"?', re.IGNORECASE)
"""The line by which a spreadsheet names the delimiter of a table."""


def is_row(line: str) -> bool:
    """Whether a line of a table holds cells: it is not empty, no remark (#), not delimiters alone, and not `SEPARATOR`."""
    stripped = line.strip()
    text = stripped.strip(" \t;,|")
    return bool(text) and not text.startswith("#") and not SEPARATOR.fullmatch(stripped)


def without_empty_end(cells: list[str], columns: int = 0) -> list[str]:
    """The cells of a row less the empty ones behind the first `columns`, as spreadsheets write them."""
    end = len(cells)
    while end > columns and not cells[end - 1].strip():
        end -= 1
    return cells[:end]


DELIMITERS = ("\t", ";", ",")
"""What parts the columns of a table, the first that its header holds."""


def table_rows(lines: Iterable[str]) -> Iterator[tuple[int, list[str]]]:
    """Number and cells of each row of a table; the first row is its header."""
    columns, delimiter = 0, ""
    for number, line in enumerate(lines, start=1):
        if is_row(line):
            delimiter = delimiter or next((each for each in DELIMITERS if each in line), ",")
            cells = without_empty_end([_unquoted(cell.strip()) for cell in line.split(delimiter)], columns)
            columns = columns or len(cells)
            yield number, cells


def _unquoted(cell: str) -> str:
    return cell[1:-1].strip() if len(cell) > 1 and cell[0] == cell[-1] == '"' else cell


def _older(data: bytes) -> str:
    try:
        return data.decode("cp1252")
    except UnicodeDecodeError:  # five bytes that Windows-1252 leaves free
        return data.decode("latin-1")


def replace_file(path: str | Path, data: bytes, *, mode: int | None = None) -> None:
    """Put `data` at `path` atomically and durably.

    The bytes go to a temporary file in the same directory, are flushed to the disk, and take the name in one step; then the
    directory is flushed. An older file's permissions (and owner, where we may) are kept; a new file gets `mode`, by default
    what the umask leaves of 0o666. A symbolic link stays one, its target is replaced. Something that is no regular file (a
    pipe, /dev/stdout) is written to as it is. Raises InputError naming the file when it cannot be written; the old one is then
    untouched.
    """
    try:
        _replace(Path(path), data, mode)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", path=path) from error


def _replace(path: Path, data: bytes, mode: int | None) -> None:
    target = Path(os.path.realpath(path))
    try:
        old: os.stat_result | None = target.stat()
    except FileNotFoundError:
        old = None
    if path.is_relative_to("/dev") or (old is not None and not stat.S_ISREG(old.st_mode)):
        path.write_bytes(data)
        return
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            os.fchmod(file.fileno(), _default_mode(mode) if old is None else stat.S_IMODE(old.st_mode))
            if old is not None and (old.st_uid, old.st_gid) != (os.geteuid(), os.getegid()) and os.geteuid() == 0:
                os.fchown(file.fileno(), old.st_uid, old.st_gid)
            file.flush()
            os.fsync(file.fileno())
        os.replace(name, target)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    sync_directory(target.parent)


def _default_mode(mode: int | None) -> int:
    if mode is not None:
        return mode
    umask = os.umask(0o077)
    os.umask(umask)
    return 0o666 & ~umask


def sync_directory(directory: Path) -> None:
    """Makes a new or changed name in a directory durable. Raises OSError."""
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
