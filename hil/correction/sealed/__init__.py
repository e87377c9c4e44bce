"""Locked files: tables that a machine can run with and only its builder can change.

    entries (name -> bytes)  --password-->  encrypted  --builder's private key-->  signed file
    signed file  --builder's public key-->  checked    --password-->               entries

Running needs the builder's public key and the reading password; changing needs the builder's private key. One file holds several
entries, each with its own password or all with a common one. Nothing is unpickled, and nothing is decrypted before the signature
over the whole file has been found good. The byte layout stands in `container`; `sealing` has the operations, `keys` the builder's
key pair and detached signatures for files that stay readable, `seen` what a machine remembers of its file, `errors` the ways a
file is refused.
"""

from hil.correction.sealed.container import Binding, Cost
from hil.correction.sealed.errors import (
    CostError,
    DamagedError,
    ForeignSignatureError,
    NotSealedError,
    ReplacedError,
    SealedError,
    SwappedError,
    TruncatedError,
    UnknownVersionError,
    UnsignedError,
    WrongKeyPasswordError,
    WrongPasswordError,
)
from hil.correction.sealed.keys import (
    check_detached,
    fingerprint,
    load_private_key,
    load_public_key,
    new_key,
    require_strong,
    save_private_key,
    save_public_key,
    sign_detached,
)
from hil.correction.sealed.sealing import (
    Passwords,
    SealedInfo,
    check,
    is_sealed,
    open_sealed,
    require_strong_new,
    reseal,
    resign,
    seal,
)
from hil.correction.sealed.seen import check_seen, remember

__all__ = [
    "Binding",
    "Cost",
    "CostError",
    "DamagedError",
    "ForeignSignatureError",
    "NotSealedError",
    "Passwords",
    "ReplacedError",
    "SealedError",
    "SealedInfo",
    "SwappedError",
    "TruncatedError",
    "UnknownVersionError",
    "UnsignedError",
    "WrongKeyPasswordError",
    "WrongPasswordError",
    "check",
    "check_detached",
    "check_seen",
    "fingerprint",
    "is_sealed",
    "load_private_key",
    "load_public_key",
    "new_key",
    "open_sealed",
    "remember",
    "require_strong",
    "require_strong_new",
    "reseal",
    "resign",
    "save_private_key",
    "save_public_key",
    "seal",
    "sign_detached",
]
