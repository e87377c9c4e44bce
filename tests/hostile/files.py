"""Hostile files, made small: what each of them asks of a reader is far more than its own size."""

from __future__ import annotations

import base64
import gzip
import json

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

MANY_DIGITS = "9" * 400
"""A whole number beyond every float."""
DEEP = 100_000

_SCRYPT = bytes.fromhex("06092b06010401da47040b")
_PBKDF2 = bytes.fromhex("06092a864886f70d01050c")
_PBES2 = bytes.fromhex("06092a864886f70d01050d")
_AES256_CBC = bytes.fromhex("060960864801650304012a")
_UNKNOWN = bytes.fromhex("06032a0304")


def _tagged(tag: int, *parts: bytes) -> bytes:
    body = b"".join(parts)
    long = b"\x81" if len(body) < 0x100 else b"\x82\x01"  # up to 511 bytes
    size = (b"" if len(body) < 0x80 else long) + bytes([len(body) & 0xFF])
    return bytes([tag]) + size + body


def _whole(value: int) -> bytes:
    return _tagged(2, value.to_bytes(value.bit_length() // 8 + 1, "big", signed=True))


def pem(der: bytes, label: str) -> bytes:
    """A PEM text with this label."""
    return f"-----BEGIN {label}-----\n{base64.encodebytes(der).decode()}-----END {label}-----\n".encode()


def _encrypted(scheme: bytes) -> bytes:
    return pem(_tagged(0x30, scheme, _tagged(4, b"c" * 64)), "ENCRYPTED PRIVATE KEY")


def _pbes2(derivation: bytes) -> bytes:
    cipher = _tagged(0x30, _AES256_CBC, _tagged(4, b"v" * 16))
    return _encrypted(_tagged(0x30, _PBES2, _tagged(0x30, derivation, cipher)))


def scrypt_key(n: int, r: int = 8, p: int = 1) -> bytes:
    """An encrypted private key that asks for this much scrypt."""
    values = _tagged(0x30, _tagged(4, b"s" * 16), _whole(n), _whole(r), _whole(p))
    return _pbes2(_tagged(0x30, _SCRYPT, values))


def pbkdf2_key(rounds: int) -> bytes:
    """An encrypted private key that asks for this many rounds of PBKDF2."""
    return _pbes2(_tagged(0x30, _PBKDF2, _tagged(0x30, _tagged(4, b"s" * 16), _whole(rounds))))


def key_of_unknown_scheme() -> bytes:
    """An encrypted private key whose scheme has an object identifier that nobody knows."""
    return _encrypted(_tagged(0x30, _UNKNOWN, _tagged(0x30)))


def key_of_unknown_derivation() -> bytes:
    """The same with PBES2 and an unknown key derivation in it."""
    return _pbes2(_tagged(0x30, _UNKNOWN, _tagged(0x30, _tagged(4, b"s" * 16))))


def key_with_false_marker() -> bytes:
    """A private key without encryption, beside the marker of one that has it."""
    der = Ed25519PrivateKey.generate().private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
    return pem(der, "PRIVATE KEY") + b"-----BEGIN ENCRYPTED PRIVATE KEY-----\n-----END ENCRYPTED PRIVATE KEY-----\n"


def plain_key_called_encrypted() -> bytes:
    """A private key without encryption in the block of one that has it."""
    der = Ed25519PrivateKey.generate().private_bytes(Encoding.DER, PrivateFormat.PKCS8, NoEncryption())
    return pem(der, "ENCRYPTED PRIVATE KEY")


def public_key_of_unknown_kind() -> bytes:
    """A public key whose algorithm has an object identifier that nobody knows."""
    return pem(_tagged(0x30, _tagged(0x30, _UNKNOWN), _tagged(3, b"\0" + b"k" * 32)), "PUBLIC KEY")


def packed(text: bytes, times: int) -> bytes:
    """A gzip file of `times` times the text, made a part at a time."""
    part = text * max(1, (1 << 20) // len(text))
    whole = gzip.compress(part, 9)
    return whole * (times * len(text) // len(part))


MODEL = {
    "format": "hil-model",
    "version": 1,
    "about": {},
    "table": {"positions_mm": [0, 1], "forward_um": [0, 0], "backward_um": [0, 0], "nodes": [], "covariance_um2": []},
    "terms": [],
}
TERM = {
    "effect": "cyclic",
    "form": "x",
    "inputs": [],
    "constants": {},
    "nonlinear": {},
    "coefficients": [],
    "covariance": [],
}


def model(**changes: object) -> str:
    """The text of a model file with other values at these keys."""
    return json.dumps({**MODEL, **changes})


def nested(depth: int = DEEP) -> str:
    """Lists in lists, as JSON and as TOML."""
    return "[" * depth + "]" * depth


def eds(objects: int, members: int = 0) -> str:
    """An EDS file of this many objects, each a variable or, with members, a record of as many."""
    lines = []
    variable = "ParameterName=a\nObjectType=7\nDataType=7\nAccessType=rw\nDefaultValue=1\n"
    for index in range(0x2000, 0x2000 + objects):
        lines.append(f"[{index:04X}]\n" + ("ParameterName=a\nObjectType=9\n" if members else variable))
        lines += [f"[{index:04X}sub{number:X}]\n{variable}" for number in range(1, members + 1)]
    return "".join(lines)


def dcf(objects: int) -> str:
    """A DCF file of this many objects with a value each."""
    return "[DeviceComissioning]\nNodeID=1\nBaudrate=500\n" + eds(objects).replace(
        "DefaultValue", "ParameterValue=2\nDefaultValue"
    )


def wide_header(columns: int) -> str:
    """Records of one row and so many columns of their own."""
    head = ",".join(["run,direction,target_mm,measured_mm", *(f"c{number}" for number in range(columns))])
    return f"{head}\n1,1,1,1{',0' * columns}\n"
