"""`hil seal`: encrypts and signs files into one sealed file."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from drivers.errors import InputError
from drivers.files import read_bytes, replace_file
from hil.correction.sealed import check, is_sealed, load_private_key, require_strong_new, reseal, seal
from hil.records.files import naming
from hil.ui.terminal.options import KEY
from hil.ui.terminal.output import print_facts, write_json
from hil.ui.terminal.passwords import password, reading_passwords


def run(args: argparse.Namespace) -> int:
    """Exit status 0. Raises InputError for wrong files, keys and passwords."""
    entries: dict[str, bytes] = {}
    for file in args.files:
        name = Path(file).name
        if name in entries:
            raise InputError(f"a second file of the name {name}, expected every name once", path=file)
        entries[name] = read_bytes(file)
    out = Path(args.out)
    if args.update or out.exists():
        old = read_bytes(out)
        if not is_sealed(old):
            raise InputError("exists and is not a sealed file; it is not overwritten", path=out)
    key_password = password(args.key_password_file, KEY, "password of the builder's key", os.environ)
    key = load_private_key(args.key, key_password)
    passwords = reading_passwords(args, list(entries), os.environ, new=True)
    require_strong_new(passwords, old if args.update else None, key.public_key())
    with naming(out):
        sealed = reseal(old, entries, passwords, key) if args.update else seal(entries, passwords, key)
        info = check(sealed, key.public_key())
    replace_file(out, sealed)
    print_facts(
        {"sealed": str(out), "entries": ", ".join(info.entries), "builder": info.builder, "sha256": info.sha256}
    )
    if args.json:
        write_json(args.json, {"sealed": str(out), **info.as_json()})
    return 0
