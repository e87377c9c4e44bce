"""Every way a sealed file is refused, so that a caller and a person can tell a typing slip from an attack.

InputError
└── SealedError
    ├── WrongPasswordError       the file is good, the password is not
    │   └── WrongKeyPasswordError    that of the builder's private key
    ├── NotSealedError           something else than a sealed file
    ├── UnknownVersionError      a sealed file of a version this program does not know
    ├── TruncatedError           the end is missing
    ├── CostError                key-derivation cost outside the limits (an attack on time or memory, or a weak setting)
    ├── ReplacedError            a good file, but older than the one used before, or another machine's
    ├── UnsignedError            no builder's signature
    ├── ForeignSignatureError    signed, by another key than the builder's
    └── DamagedError             the bytes are not those that were signed
        └── SwappedError             parts of sealed files were put together anew
"""

from __future__ import annotations

from drivers.errors import InputError


class SealedError(InputError):
    """A sealed file was refused."""


class WrongPasswordError(SealedError):
    """The file is intact, but the password is wrong."""


class WrongKeyPasswordError(WrongPasswordError):
    """This password does not open the builder's private key."""


class NotSealedError(SealedError):
    """The bytes are no sealed file."""


class UnknownVersionError(SealedError):
    """A sealed file of a version that this program does not know."""


class TruncatedError(SealedError):
    """The end of the file is missing."""


class CostError(SealedError):
    """The key-derivation cost lies outside the limits."""


class ReplacedError(SealedError):
    """A validly signed file in the place of the one that was used before: an older one, or another machine's."""


class UnsignedError(SealedError):
    """The file carries no signature."""


class ForeignSignatureError(SealedError):
    """The file was signed with another key than the builder's."""


class DamagedError(SealedError):
    """The bytes are not those that were signed."""


class SwappedError(DamagedError):
    """Parts of sealed files were put together anew: another file's header, or entries in another order."""
