"""`hil check`: verifies the builder's signature of a file. Needs no password."""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path

from drivers.errors import InputError
from drivers.files import read_bytes
from hil.correction.sealed import SealedError, check, check_detached, fingerprint, is_sealed, load_public_key
from hil.records.files import naming
from hil.ui.terminal.output import binding_facts, print_facts, write_json


def run(args: argparse.Namespace) -> int:
    """Exit status 0: good; 1: not. Raises InputError for a file that cannot be checked."""
    data, public = read_bytes(args.file), load_public_key(args.builder)
    facts: dict[str, object] = {"file": str(args.file), "builder": fingerprint(public)}
    header: dict[str, str] = {}
    try:
        if is_sealed(data):
            info = check(data, public)
            facts |= info.as_json()
            header = binding_facts(info.binding)
        else:
            signature = Path(args.signature or f"{args.file}.sig")
            if not signature.exists():
                raise InputError(f"is not a sealed file, and there is no signature {signature}", path=args.file)
            with naming(signature):
                check_detached(data, read_bytes(signature), public)
            facts["sha256"] = hashlib.sha256(data).hexdigest()
        verdict, reason, kind = True, "as the builder signed it", None
    except SealedError as error:
        verdict, reason, kind = False, error.what, type(error).__name__
    facts |= {"good": verdict, "reason": reason, "kind": kind}
    shown = {name: _text(value) for name, value in facts.items() if name not in ("good", "kind", "reason", "binding")}
    print_facts(shown | header)
    print(f"{'good' if verdict else 'NOT GOOD'}: {reason}")
    if args.json:
        write_json(args.json, facts)
    return 0 if verdict else 1


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} ({size} bytes)" for name, size in value.items())
    return str(value)
