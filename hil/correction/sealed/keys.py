"""The builder's key pair (Ed25519, RFC 8032) as files, and detached signatures for files that stay readable.

The private key is kept as a password-encrypted PKCS #8 PEM file. Its key derivation is scrypt (RFC 7914, section 7.1: scrypt in
PBES2), memory-hard like that of the sealed files; any tool that knows PKCS #8 with scrypt reads it.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import unicodedata
from pathlib import Path

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat import asn1
from cryptography.hazmat._oid import ObjectIdentifier  # of cryptography.x509, which every start would load for it
from cryptography.hazmat.primitives import padding
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms, modes
from cryptography.hazmat.primitives.kdf.scrypt import Scrypt
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    PublicFormat,
    load_der_private_key,
    load_pem_public_key,
)

from drivers.errors import InputError
from drivers.files import read_text, replace_file
from hil.correction.sealed.container import SIGNATURE_BYTES, Cost
from hil.correction.sealed.errors import CostError, DamagedError, ForeignSignatureError, WrongKeyPasswordError
from hil.records.files import parse_json

KEY_COST = Cost(n=1 << 14, r=8, p=5)
"""As strong as the sealed files' default with half its memory, which other tools accept by default."""

MAX_KEY_FILE_BYTES = 1 << 16
"""An encrypted Ed25519 key has about 400; comments may stand before it."""
MAX_ROUNDS = 1 << 22
"""Most rounds of PBKDF2 (RFC 8018): seven times the 600,000 that OWASP recommends for HMAC-SHA-256, 1.3 s at 3 million a second."""

_DETACHED = b"hil detached signature, version 1\0"
_DETACHED_FORMAT = "hil-signature-1"


def new_key() -> Ed25519PrivateKey:
    """A new builder's key."""
    return Ed25519PrivateKey.generate()


def raw(public: Ed25519PublicKey) -> bytes:
    """The 32 bytes of a public key."""
    return public.public_bytes(Encoding.Raw, PublicFormat.Raw)


def fingerprint(public: Ed25519PublicKey | bytes) -> str:
    """A short name of a public key to compare by eye: the first 16 bytes of its SHA-256, in groups of four hex digits."""
    data = public if isinstance(public, bytes) else raw(public)
    digits = hashlib.sha256(data).hexdigest()[:32]
    return " ".join(digits[i : i + 4] for i in range(0, 32, 4))


def password_bytes(password: str) -> bytes:
    """A password as bytes in NFC, so that the same characters typed on another system give the same bytes. Raises InputError for
    ""."""
    if not password:
        raise InputError("the password is empty, expected at least one character")
    return unicodedata.normalize("NFC", password).encode("utf-8")


NEW_CHARACTERS = 15
"""Least length of a new password: NIST SP 800-63B-4 (2025), 3.1.1.2, for one that is the only factor, as it is for who has the file.
Counted in code points, with no rule of composition, as there."""
NEW_DIFFERENT = 5
"""Least number of different characters of a new one, against the repetitive ones that its list of refused passwords is to hold."""


def require_strong(password: str, what: str) -> None:
    """Raises InputError for a new password that is too short or repeats itself; those that exist are not asked. what: names it."""
    text = unicodedata.normalize("NFC", password)
    if len(text) < NEW_CHARACTERS or len(set(text)) < NEW_DIFFERENT:
        raise InputError(
            f"{what} is new and has {len(text)} characters, {len(set(text))} of them different: expected at least {NEW_CHARACTERS},"
            f" {NEW_DIFFERENT} of them different, such as some words (NIST SP 800-63B-4)"
        )


def save_private_key(path: str | Path, key: Ed25519PrivateKey, password: str, *, cost: Cost = KEY_COST) -> None:
    """Write an encrypted PKCS #8 PEM file, readable by its owner only.

    Raises InputError when the file exists already, and for a password that is too weak (`require_strong`).
    """
    if os.path.lexists(path):
        raise InputError("exists already; a builder's key is never overwritten", path=path)
    require_strong(password, "password of the new key")
    replace_file(path, _encrypted_pem(key, password_bytes(password), cost), mode=0o600)


def load_private_key(path: str | Path, password: str) -> Ed25519PrivateKey:
    """Read a private key. Raises WrongKeyPasswordError, CostError for a key derivation that would take too long or too much memory,
    before it is computed, or InputError when the file is no encrypted Ed25519 key."""
    block = _ENCRYPTED.search(_pem(path))
    try:
        der = b"" if block is None else base64.b64decode(b"".join(block[1].split()), validate=True)
        _check_cost(der)
    except CostError as error:
        raise CostError(error.what, path=path) from error
    except ValueError as error:
        raise InputError("is not a password-protected private key (PEM, PKCS #8, PBES2)", path=path) from error
    try:
        key = load_der_private_key(der, password_bytes(password))
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise WrongKeyPasswordError("the password does not open this key, or the file is damaged", path=path) from error
    if not isinstance(key, Ed25519PrivateKey):
        raise InputError("is a private key of another kind, expected Ed25519", path=path)
    return key


def _pem(path: str | Path) -> bytes:
    """A key file without what an editor puts around its text: a byte-order mark, UTF-16."""
    return read_text(path, MAX_KEY_FILE_BYTES, older=True, expected="a key (PEM)").encode()


def save_public_key(path: str | Path, public: Ed25519PublicKey) -> None:
    """Write a public key as PEM. Raises InputError when the file exists already."""
    if os.path.lexists(path):
        raise InputError("exists already; a builder's key is never overwritten", path=path)
    replace_file(path, public.public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo))


def load_public_key(path: str | Path) -> Ed25519PublicKey:
    """Read a public key. Raises InputError when the file is no Ed25519 public key."""
    data = _pem(path)
    try:
        public = load_pem_public_key(data)
    except (ValueError, UnsupportedAlgorithm) as error:
        raise InputError("is not a public key (PEM)", path=path) from error
    if not isinstance(public, Ed25519PublicKey):
        raise InputError("is a public key of another kind, expected Ed25519", path=path)
    return public


def sign_detached(data: bytes, key: Ed25519PrivateKey) -> bytes:
    """The contents of a `.sig` file for `data`: a small JSON text with the builder's public key and the signature."""
    form = {
        "format": _DETACHED_FORMAT,
        "builder": raw(key.public_key()).hex(),
        "signature": key.sign(_DETACHED + data).hex(),
    }
    return (json.dumps(form, indent=2) + "\n").encode("ascii")


def check_detached(data: bytes, signature: bytes, public: Ed25519PublicKey) -> None:
    """Return if `signature` (the contents of a `.sig` file) is the builder's over `data`.

    Raises ForeignSignatureError (good, but another key's), DamagedError (data or signature changed), InputError (no .sig file).
    """
    try:
        form = parse_json(signature)
        if form["format"] != _DETACHED_FORMAT:
            raise ValueError("format")
        builder, value = bytes.fromhex(form["builder"]), bytes.fromhex(form["signature"])
        if len(builder) != len(raw(public)) or len(value) != SIGNATURE_BYTES:
            raise ValueError("length")
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError("is not a detached signature of this program") from error
    check_signature(_DETACHED + data, value, builder, public)


def check_signature(message: bytes, signature: bytes, stated: bytes, public: Ed25519PublicKey) -> None:
    """Returns if the builder signed `message`. stated: the public key in the file, 32 bytes.

    Raises ForeignSignatureError for another key's good signature, DamagedError for any other.
    """
    try:
        public.verify(signature, message)
    except InvalidSignature:
        pass
    else:
        if stated == raw(public):
            return
        raise DamagedError("the builder's public key in it was changed")
    if stated != raw(public):
        try:
            Ed25519PublicKey.from_public_bytes(stated).verify(signature, message)
        except (InvalidSignature, ValueError) as error:
            raise DamagedError("signature does not fit: the file was changed, or not signed by this builder") from error
        raise ForeignSignatureError(
            f"signed with another key, fingerprint {fingerprint(stated)}, expected {fingerprint(public)}"
        )
    raise DamagedError("signature does not fit: the file was changed after the builder signed it")


# -- PKCS #8 ---------------------------------------------------------------------------------------------------------------
_PBES2 = ObjectIdentifier("1.2.840.113549.1.5.13")
_PBKDF2 = ObjectIdentifier("1.2.840.113549.1.5.12")
_SCRYPT = ObjectIdentifier("1.3.6.1.4.1.11591.4.11")
_AES256_CBC = ObjectIdentifier("2.16.840.1.101.3.4.1.42")
_ENCRYPTED = re.compile(rb"-----BEGIN ENCRYPTED PRIVATE KEY-----([A-Za-z0-9+/=\s]*)-----END ENCRYPTED PRIVATE KEY-----")


@asn1.sequence
class _Algorithm:
    """AlgorithmIdentifier (RFC 5280, 4.1.1.2)."""

    name: ObjectIdentifier
    parameters: asn1.TLV

    @classmethod
    def of(cls, name: ObjectIdentifier, parameters: object) -> _Algorithm:
        return cls(name=name, parameters=asn1.decode_der(asn1.TLV, asn1.encode_der(parameters)))


@asn1.sequence
class _EncryptedKey:
    """EncryptedPrivateKeyInfo (RFC 5958, 3)."""

    scheme: _Algorithm
    ciphertext: bytes


@asn1.sequence
class _Scheme:
    """Parameters of PBES2 (RFC 8018, A.4)."""

    derivation: _Algorithm
    cipher: _Algorithm


@asn1.sequence
class _Scrypt:
    """RFC 7914, 7.1."""

    salt: bytes
    n: int
    r: int
    p: int
    key_length: int | None


@asn1.sequence
class _Pbkdf2:
    """RFC 8018, A.2; the pseudo-random function follows where it is not HMAC-SHA-1."""

    salt: bytes
    rounds: int
    key_length: int | None
    function: _Algorithm | None


def _encrypted_pem(key: Ed25519PrivateKey, password: bytes, cost: Cost) -> bytes:
    """With scrypt and AES-256-CBC. The library's own writer has PBKDF2 with 2048 rounds, 1.3 ms for a guess in place of 360."""
    plain = key.private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
    salt, vector = os.urandom(16), os.urandom(16)
    secret = Scrypt(salt=salt, length=32, n=cost.n, r=cost.r, p=cost.p).derive(password)
    padder = padding.PKCS7(128).padder()
    encryptor = Cipher(algorithms.AES(secret), modes.CBC(vector)).encryptor()
    ciphertext = encryptor.update(padder.update(plain) + padder.finalize()) + encryptor.finalize()
    asked = _Scrypt(salt=salt, n=cost.n, r=cost.r, p=cost.p, key_length=None)
    scheme = _Scheme(derivation=_Algorithm.of(_SCRYPT, asked), cipher=_Algorithm.of(_AES256_CBC, vector))
    whole = asn1.encode_der(_EncryptedKey(scheme=_Algorithm.of(_PBES2, scheme), ciphertext=ciphertext))
    body = base64.b64encode(whole)
    lines = [body[i : i + 64] for i in range(0, len(body), 64)]
    return b"\n".join([b"-----BEGIN ENCRYPTED PRIVATE KEY-----", *lines, b"-----END ENCRYPTED PRIVATE KEY-----", b""])


def _check_cost(der: bytes) -> None:
    """Checks the key derivation that an encrypted key asks for, before anything is derived.

    Raises CostError for a cost outside the limits, ValueError for anything but PBES2 with scrypt or PBKDF2.
    """
    scheme = asn1.decode_der(_EncryptedKey, der).scheme
    if scheme.name != _PBES2:
        raise ValueError("not PBES2")
    derivation = scheme.parameters.parse(_Scheme).derivation
    if derivation.name == _SCRYPT:
        asked = derivation.parameters.parse(_Scrypt)
        Cost(asked.n, asked.r, asked.p)
    elif derivation.name == _PBKDF2:
        rounds = derivation.parameters.parse(_Pbkdf2).rounds
        if not 1 <= rounds <= MAX_ROUNDS:
            raise CostError(f"key derivation of {rounds} rounds is absurd, expected 1 to {MAX_ROUNDS}")
    else:
        raise ValueError("neither scrypt nor PBKDF2")
