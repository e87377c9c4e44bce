"""Who signed the files that a report rests on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from hil.correction.sealed import SealedError, check, check_detached, fingerprint, is_sealed
from hil.records.files import read_bytes

NOT_GOOD = "NOT GOOD: "


def signatures(paths: Sequence[str], public: Ed25519PublicKey) -> dict[str, str]:
    """Each file's name -> what its signature, its own or the FILE.sig beside it, is worth."""
    return {Path(path).name: _signature(Path(path), public) for path in paths}


def _signature(path: Path, public: Ed25519PublicKey) -> str:
    data = read_bytes(path)
    beside = path.with_name(f"{path.name}.sig")
    try:
        if is_sealed(data):
            check(data, public)
        elif beside.exists():
            check_detached(data, read_bytes(beside), public)
        else:
            return "not signed"
    except SealedError as error:
        return NOT_GOOD + error.what
    return f"signed by {fingerprint(public)}"
