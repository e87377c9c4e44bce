"""Operations on a sealed file: seal, check, open, replace entries, sign again; in memory and on disk.

Key of an entry: scrypt over its password. Cipher: ChaCha20-Poly1305 (RFC 8439) with a random nonce, `container.associated_data`
authenticated. Signature: Ed25519 over the whole file. Entries that share a password share a salt, so a common password is
stretched once.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt

from drivers.errors import InputError
from hil.correction.sealed import container, keys
from hil.correction.sealed.container import Binding, Container, Cost, EntryHeader, Header
from hil.correction.sealed.errors import SealedError, WrongPasswordError

Passwords = str | Mapping[str, str]
"""One common password, or one for each entry by name."""

DEFAULT_COST = Cost()

_TAG_BYTES = 16
_DOMAIN = b"hil sealed file\0"


@dataclass(frozen=True)
class SealedInfo:
    """What a sealed file shows without a password, its signature found good. `id`: its own for life, in hex.

    `entries` maps each name to its size in bytes; `sha256` is the hash of the file, in hex; `builder` the signer's fingerprint;
    `binding` what it is bound to, None for a file of version 1.
    """

    id: str
    version: int
    builder: str
    entries: Mapping[str, int]
    kdf: str
    cipher: str
    sha256: str
    binding: Binding | None = None

    def as_json(self) -> dict[str, object]:
        """The same as plain JSON values."""
        binding = None if self.binding is None else self.binding.as_json()
        return {**vars(self), "entries": dict(self.entries), "binding": binding}


def seal(
    entries: Mapping[str, bytes],
    passwords: Passwords,
    builder_key: Ed25519PrivateKey,
    *,
    cost: Cost | None = None,
    bound_to: Mapping[str, Any] | None = None,
) -> bytes:
    """The bytes of a sealed file with these entries; bound_to: see `Binding.of`.

    Raises InputError for a bad name, no entry, a missing password, or a binding that is too large.
    """
    builder = keys.raw(builder_key.public_key())
    header = Header(os.urandom(16), cost or DEFAULT_COST, builder, entries=(), binding=_next_binding(None, bound_to))
    return _build(header, [], entries, passwords, builder_key)


def _next_binding(before: Binding | None, bound_to: Mapping[str, Any] | None) -> Binding:
    """The binding after `before`; bound_to: None, the same as before."""
    kept = {} if before is None else before.of
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return Binding(1 if before is None else before.counter + 1, now, kept if bound_to is None else bound_to)


def check(data: bytes, builder_public: Ed25519PublicKey) -> SealedInfo:
    """Check layout and signature without a password. Raises the SealedError that says what is wrong."""
    parts = _checked(data, builder_public)
    sizes = {
        entry.name: len(ciphertext) - _TAG_BYTES
        for entry, ciphertext in zip(parts.header.entries, parts.ciphertexts, strict=True)
        if not container.VACANT.fullmatch(entry.name)
    }
    return SealedInfo(
        id=parts.header.file_id.hex(),
        version=parts.header.version,
        builder=keys.fingerprint(parts.header.builder),
        entries=sizes,
        kdf=f"{container.KDF} {parts.header.cost}",
        cipher=container.CIPHER,
        sha256=hashlib.sha256(data).hexdigest(),
        binding=parts.header.binding,
    )


def open_sealed(
    data: bytes, passwords: Passwords, builder_public: Ed25519PublicKey, *, names: Iterable[str] | None = None
) -> dict[str, bytes]:
    """The entries by name, after the signature over the whole file was found good.

    Opens the entries in `names`; without it every entry for a common password, or those that `passwords` names. Raises the
    SealedError that says what is wrong, InputError for a name the file does not hold.
    """
    parts = _checked(data, builder_public)
    present = [entry.name for entry in parts.header.entries if not container.VACANT.fullmatch(entry.name)]
    wanted = list(names) if names is not None else present if isinstance(passwords, str) else list(passwords)
    for name in wanted:
        if name not in present:
            raise InputError(f"sealed file holds no entry {name}, only {', '.join(present)}")
    stretched = _Stretched(parts.header.cost)
    opened: dict[str, bytes] = {}
    for number, (entry, ciphertext) in enumerate(zip(parts.header.entries, parts.ciphertexts, strict=True)):
        if entry.name in wanted:
            cipher = ChaCha20Poly1305(stretched.key(_password(passwords, entry.name), entry.salt))
            try:
                plain = cipher.decrypt(entry.nonce, ciphertext, container.associated_data(parts.header, number))
            except InvalidTag as error:
                raise WrongPasswordError(f"wrong password for entry {entry.name}") from error
            opened[entry.name] = plain
    return opened


def reseal(
    data: bytes,
    changes: Mapping[str, bytes],
    passwords: Passwords,
    builder_key: Ed25519PrivateKey,
    *,
    bound_to: Mapping[str, Any] | None = None,
    without: Iterable[str] = (),
) -> bytes:
    """A sealed file with the entries in `changes` replaced or added, those in `without` taken out, and signed anew; its counter is one
    more.

    bound_to: what the file is bound to from now on; None leaves that as it was. Only the changed entries' passwords are needed; the
    others stay encrypted as they are. Raises the SealedError that says what is wrong unless the present file is signed with the
    same key, InputError for a binding that is too large, and where no entry would be left.
    """
    parts = _checked(data, builder_key.public_key())
    out = set(without)
    if not changes and not out:
        raise InputError("nothing to seal, expected at least one entry")
    # contents are bound to their place in the file, so what is kept keeps its place
    kept = [
        None if entry.name in out or container.VACANT.fullmatch(entry.name) else (entry, ciphertext)
        for entry, ciphertext in zip(parts.header.entries, parts.ciphertexts, strict=True)
    ]
    header = replace(parts.header, binding=_next_binding(parts.header.binding, bound_to))
    return _build(header, kept, changes, passwords, builder_key)


def require_strong_new(passwords: Mapping[str, str], present: bytes | None, builder_public: Ed25519PublicKey) -> None:
    """Raises InputError for a new password of an entry that is too weak (`keys.require_strong`), by the entry's name.

    present: the file as it is, None for none; a password that opens its entry there is not new.
    """
    there = () if present is None else check(present, builder_public).entries
    for name, password in passwords.items():
        try:
            keys.require_strong(password, f"password of {name}")
        except InputError:
            if present is None or name not in there:
                raise
            try:
                open_sealed(present, {name: password}, builder_public)
            except WrongPasswordError:
                pass
            else:
                continue
            raise


def resign(data: bytes, builder_public: Ed25519PublicKey, new_builder_key: Ed25519PrivateKey) -> bytes:
    """The same file, binding and counter included, signed with another builder's key; needs no password.

    The present signature must be `builder_public`'s.
    """
    parts = _checked(data, builder_public)
    header = replace(parts.header, builder=keys.raw(new_builder_key.public_key()))
    signed = container.pack(header, parts.ciphertexts)
    return signed + new_builder_key.sign(_DOMAIN + signed)


def is_sealed(data: bytes) -> bool:
    """Whether the bytes begin like a sealed file."""
    return data.startswith(container.MAGIC)


def _build(
    base: Header,
    kept: Sequence[tuple[EntryHeader, bytes] | None],
    changes: Mapping[str, bytes],
    passwords: Passwords,
    builder_key: Ed25519PrivateKey,
) -> bytes:
    """kept: what stays, by place in the file, None for a vacant one; new entries take those first."""
    names: list[str | None] = [None if one is None else one[0].name for one in kept]
    for new in changes:
        if new not in names:
            place = names.index(None) if None in names else len(names)
            names[place : place + 1] = [new]
    while names and names[-1] is None:
        names.pop()
    _check_names(changes, passwords, names)
    stretched = _Stretched(base.cost)
    salts: dict[str, bytes] = {}
    entries: list[EntryHeader] = []
    for number, name in enumerate(names):
        present = kept[number] if number < len(kept) else None
        if name is not None and name in changes:
            salt = salts.setdefault(_password(passwords, name), os.urandom(16))
            entries.append(EntryHeader(name, salt, os.urandom(12)))
        elif present is not None:
            entries.append(present[0])
        else:
            entries.append(EntryHeader(f"_vacant_{number}", os.urandom(16), os.urandom(12)))
    header = replace(base, entries=tuple(entries))
    ciphertexts = []
    for number, entry in enumerate(entries):
        present = kept[number] if number < len(kept) else None
        if entry.name in changes:
            cipher = ChaCha20Poly1305(stretched.key(_password(passwords, entry.name), entry.salt))
            data = bytes(changes[entry.name])
            ciphertexts.append(cipher.encrypt(entry.nonce, data, container.associated_data(header, number)))
        else:
            ciphertexts.append(os.urandom(_TAG_BYTES) if present is None else present[1])
    signed = container.pack(header, tuple(ciphertexts))
    return signed + builder_key.sign(_DOMAIN + signed)


def _check_names(changes: Mapping[str, bytes], passwords: Passwords, names: Sequence[str | None]) -> None:
    """names: of all entries afterwards."""
    if not names:
        raise InputError("nothing to seal, expected at least one entry")
    if len(names) > container.MAX_ENTRIES:
        raise InputError(f"too many entries to seal, expected at most {container.MAX_ENTRIES}")
    for name in changes:
        if not container.NAME.fullmatch(name) or container.VACANT.fullmatch(name):
            raise InputError(f"entry name {name!r} cannot be used, expected up to 100 letters, digits, '.', '_' or '-'")
    if not isinstance(passwords, str):
        for name in passwords:
            if name not in changes:
                raise InputError(f"a password is given for entry {name}, which is not among those to seal")


def _checked(data: bytes, builder_public: Ed25519PublicKey) -> Container:
    parts = container.unpack(data)
    try:
        keys.check_signature(_DOMAIN + parts.signed, parts.signature, parts.header.builder, builder_public)
    except SealedError as error:
        raise type(error)(f"sealed file refused: {error.what}") from error
    return parts


def _password(passwords: Passwords, name: str) -> str:
    if isinstance(passwords, str):
        return passwords
    if name not in passwords:
        raise InputError(f"no password is given for entry {name}")
    return passwords[name]


class _Stretched:
    """Keys of one file by password and salt, each derived once."""

    def __init__(self, cost: Cost) -> None:
        self._cost = cost
        self._keys: dict[tuple[str, bytes], bytes] = {}

    def key(self, password: str, salt: bytes) -> bytes:
        if (password, salt) not in self._keys:
            derive = Scrypt(salt=salt, length=32, n=self._cost.n, r=self._cost.r, p=self._cost.p)
            self._keys[password, salt] = derive.derive(keys.password_bytes(password))
        return self._keys[password, salt]
