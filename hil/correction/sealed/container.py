"""The bytes of a sealed file: layout, limits, and nothing that needs a key.

    "HILSEAL"  version (1 byte)  header length (u32)  header  chunk*  signature (64 bytes)
    chunk = file id (16 bytes)  entry number (u16)  length (u32)  ciphertext with tag

All numbers are big-endian. The header is canonical JSON (ASCII, sorted keys, no spaces): file id, key derivation and its cost,
cipher, builder's public key, and for each entry name, salt and nonce; since version 2 also a binding: counter, date, and what the
contents belong to. Only the one canonical spelling is accepted, so a header has no bits that mean nothing. Each chunk repeats the
file id and its number, which is how a header or an entry from elsewhere is told from mere damage. The signature covers every byte
before it.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.errors import InputError
from hil.correction.sealed.errors import (
    CostError,
    DamagedError,
    NotSealedError,
    SwappedError,
    TruncatedError,
    UnknownVersionError,
    UnsignedError,
)
from hil.records.files import parse_json

MAGIC = b"HILSEAL"
VERSIONS = (1, 2)
"""What is read: files of version 1 carry no binding. Written is the last."""
_ENTRY_VERSION = 1
"""What entries are authenticated with, the same in both versions: an old file's entries are kept as they are when it is resealed."""
CIPHER = "chacha20-poly1305"
KDF = "scrypt"
SIGNATURE_BYTES = 64
MAX_HEADER_BYTES = 1 << 20
MAX_BINDING_BYTES = 1 << 15
"""Some 40 axes of a machine with what is bound of each; far below what would slow reading down."""
MAX_ENTRIES = 1000
MAX_KDF_MEMORY_BYTES = 256 << 20
MAX_KDF_WORK = 1 << 23
"""Largest n·r·p: about 8 times the work of the default cost."""

NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,99}")
"""An entry's name: safe as a file name everywhere."""
VACANT = re.compile(r"_vacant_[0-9]+")
"""Name of a place whose entry was taken out. Entries are authenticated with their place, so those behind it keep theirs; the next new
entry takes it."""

_FRONT = struct.Struct(">7sBI")
_CHUNK = struct.Struct(">16sHI")


@dataclass(frozen=True)
class Cost:
    """scrypt's cost (RFC 7914): n blocks (a power of two) of 128·r bytes, p times. The default takes 32 MiB.

    Raises CostError outside the limits, before anything is computed.
    """

    n: int = 1 << 15
    r: int = 8
    p: int = 3

    def __post_init__(self) -> None:
        if self.n < 2 or self.n & (self.n - 1) or self.r < 1 or self.p < 1:
            raise CostError(f"key derivation cost {self} is not valid, expected n a power of two, r and p at least 1")
        if 128 * self.n * self.r > MAX_KDF_MEMORY_BYTES or self.n * self.r * self.p > MAX_KDF_WORK:
            raise CostError(
                f"key derivation cost {self} is absurd, expected at most {MAX_KDF_MEMORY_BYTES >> 20} MiB "
                f"and n·r·p at most {MAX_KDF_WORK}"
            )

    def __str__(self) -> str:
        return f"n={self.n} r={self.r} p={self.p}"


@dataclass(frozen=True)
class EntryHeader:
    """What is known about an entry without its password."""

    name: str
    salt: bytes
    nonce: bytes


@dataclass(frozen=True)
class Binding:
    """What a file is bound to: signed, readable without a password.

    counter: 1 for a file that was sealed anew, one more each time it is resealed; date: of that, ISO 8601 in UTC;
    of: plain JSON values that say what the contents belong to (machine, axis, zero of the axis)
    """

    counter: int
    date: str
    of: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """The same as plain JSON values."""
        return {"counter": self.counter, "date": self.date, "of": dict(self.of)}


@dataclass(frozen=True)
class Header:
    """The header: all that is not secret. binding: None in files of version 1."""

    file_id: bytes
    cost: Cost
    builder: bytes
    entries: tuple[EntryHeader, ...]
    binding: Binding | None = None

    @property
    def version(self) -> int:
        """1 without a binding, 2 with one."""
        return 1 if self.binding is None else 2


@dataclass(frozen=True)
class Container:
    """A whole file taken apart. `signed` is every byte that the signature covers."""

    header: Header
    ciphertexts: tuple[bytes, ...]
    signed: bytes
    signature: bytes


def pack(header: Header, ciphertexts: tuple[bytes, ...]) -> bytes:
    """The bytes to sign; append the signature and the file is whole. Raises InputError for a binding that is too large or no JSON."""
    _check_binding(header.binding)
    text = _encode(header)
    chunks = [
        _CHUNK.pack(header.file_id, number, len(ciphertext)) + ciphertext
        for number, ciphertext in enumerate(ciphertexts)
    ]
    return b"".join([_FRONT.pack(MAGIC, header.version, len(text)), text, *chunks])


def unpack(data: bytes) -> Container:
    """Take a file apart. Raises the SealedError that fits; checks layout and limits, not the signature."""
    if not data or not data.startswith(MAGIC[: len(data)]):
        raise NotSealedError("is not a sealed file")
    if len(data) < _FRONT.size:
        raise TruncatedError(f"sealed file ends after {len(data)} bytes, in its first line")
    _, version, header_bytes = _FRONT.unpack_from(data)
    if version not in VERSIONS:
        raise UnknownVersionError(f"sealed file has version {version}, expected {' or '.join(map(str, VERSIONS))}")
    if header_bytes > MAX_HEADER_BYTES:
        raise DamagedError(f"sealed file states a header of {header_bytes} bytes, expected at most {MAX_HEADER_BYTES}")
    position = _FRONT.size + header_bytes
    if position > len(data):
        raise TruncatedError(f"sealed file ends after {len(data)} bytes, in its header")
    header = _decode(data[_FRONT.size : position], version)
    ciphertexts = []
    for number, entry in enumerate(header.entries):
        ciphertext, position = _chunk(data, position, header, number, entry)
        ciphertexts.append(ciphertext)
    signature = data[position:]
    if not signature:
        raise UnsignedError("sealed file carries no builder's signature")
    if len(signature) < SIGNATURE_BYTES:
        raise TruncatedError(f"sealed file ends after {len(data)} bytes, in its signature")
    if len(signature) > SIGNATURE_BYTES:
        raise DamagedError(f"sealed file has {len(signature) - SIGNATURE_BYTES} bytes behind its end")
    return Container(header, tuple(ciphertexts), data[:position], signature)


def associated_data(header: Header, number: int) -> bytes:
    """What the cipher authenticates beside entry `number`: version of the entries, file id, key derivation, cipher and the entry's own
    header.

    The builder's key, the binding and the other entries are left out, so that one entry can be replaced, and the file signed anew,
    without the other passwords; those parts are held by the signature.
    """
    form = _plain(header)
    del form["builder"]
    form.pop("binding", None)
    form["entries"] = [number, _plain_entry(header.entries[number])]
    return MAGIC + bytes([_ENTRY_VERSION]) + _canonical(form)


def _chunk(data: bytes, position: int, header: Header, number: int, entry: EntryHeader) -> tuple[bytes, int]:
    if position + _CHUNK.size > len(data):
        raise TruncatedError(f"sealed file ends after {len(data)} bytes, before entry {entry.name}")
    file_id, stated, length = _CHUNK.unpack_from(data, position)
    if file_id != header.file_id:
        raise SwappedError(
            f"contents of entry {entry.name} belong to another sealed file than the header, or are damaged"
        )
    if stated != number:
        raise SwappedError(f"contents of entry {entry.name} are those of entry number {stated}, expected {number}")
    start = position + _CHUNK.size
    if start + length > len(data):
        raise TruncatedError(f"sealed file ends after {len(data)} bytes, in entry {entry.name}")
    return data[start : start + length], start + length


def _canonical(form: object) -> bytes:
    return json.dumps(form, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode("ascii")


def _plain_entry(entry: EntryHeader) -> dict[str, str]:
    return {"name": entry.name, "nonce": entry.nonce.hex(), "salt": entry.salt.hex()}


def _plain(header: Header) -> dict[str, object]:
    binding = {} if header.binding is None else {"binding": header.binding.as_json()}
    return {
        **binding,
        "builder": header.builder.hex(),
        "cipher": CIPHER,
        "entries": [_plain_entry(entry) for entry in header.entries],
        "id": header.file_id.hex(),
        "kdf": {"n": header.cost.n, "name": KDF, "p": header.cost.p, "r": header.cost.r},
    }


def _encode(header: Header) -> bytes:
    return _canonical(_plain(header))


def _check_binding(binding: Binding | None) -> None:
    """Raise InputError for one that could not be read back."""
    if binding is None:
        return
    try:
        size = len(_canonical(binding.as_json()))
    except (TypeError, ValueError, RecursionError) as error:
        raise InputError(f"what a sealed file is to be bound to is no JSON: {error}") from error
    if size > MAX_BINDING_BYTES:
        raise InputError(f"what a sealed file is to be bound to has {size} bytes, expected at most {MAX_BINDING_BYTES}")


def _binding(form: Any) -> Binding:
    """Raises ValueError, KeyError and TypeError for anything that `Binding.as_json` did not write."""
    counter, date, of = form["counter"], form["date"], form["of"]
    if type(counter) is not int or counter < 1 or not isinstance(date, str) or not isinstance(of, dict):
        raise ValueError("no binding")
    if len(_canonical(form)) > MAX_BINDING_BYTES:
        raise ValueError("binding too large")
    return Binding(counter, date, of)


def _decode(text: bytes, version: int) -> Header:
    try:
        form = parse_json(text)
        kdf = form["kdf"]
        if form["cipher"] != CIPHER or kdf["name"] != KDF:
            raise DamagedError(f"sealed file's header names a cipher or key derivation other than {CIPHER} and {KDF}")
        cost = (kdf["n"], kdf["r"], kdf["p"])
        if not all(type(value) is int for value in cost):
            raise DamagedError("sealed file's header states a key derivation cost that is not a whole number")
        header = Header(
            file_id=_hex(form["id"], 16),
            cost=Cost(*cost),
            builder=_hex(form["builder"], 32),
            entries=tuple(
                EntryHeader(name=entry["name"], salt=_hex(entry["salt"], 16), nonce=_hex(entry["nonce"], 12))
                for entry in form["entries"]
            ),
            binding=_binding(form["binding"]) if version > 1 else None,
        )
        names = [entry.name for entry in header.entries]
        good = 0 < len(names) <= MAX_ENTRIES and len(set(names)) == len(names) and all(map(NAME.fullmatch, names))
        if not good or _encode(header) != text:
            raise DamagedError("sealed file's header is damaged: not in its canonical form")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise DamagedError(f"sealed file's header is damaged: {type(error).__name__}") from error
    return header


def _hex(text: object, size: int) -> bytes:
    if not isinstance(text, str):
        raise TypeError("not a string")
    value = bytes.fromhex(text)
    if len(value) != size:
        raise ValueError("wrong length")
    return value
