"""`hil seal`, `open`, `sign` and `check`: sealed files, the builder's key and signatures."""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from pathlib import Path

from drivers.errors import InputError
from drivers.files import read_bytes, replace_file
from hil.axis.axis_file import load_axis
from hil.correction.sealed import (
    SealedError,
    check,
    check_detached,
    fingerprint,
    is_sealed,
    load_private_key,
    load_public_key,
    new_key,
    open_sealed,
    require_strong_new,
    reseal,
    resign,
    save_private_key,
    save_public_key,
    seal,
    sign_detached,
)
from hil.correction.store import SealedStore
from hil.records.files import naming
from hil.ui.terminal.options import KEY
from hil.ui.terminal.output import binding_facts, print_facts, write_json
from hil.ui.terminal.passwords import password, reading_passwords


def run_seal(args: argparse.Namespace) -> int:
    """Encrypt and sign files as one sealed file; returns 0. Raises InputError for wrong files, keys and passwords."""
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


def run_open(args: argparse.Namespace) -> int:
    """Decrypt a sealed file; returns 0. Raises SealedError for a file that is refused, InputError for wrong arguments."""
    data, public = read_bytes(args.sealed), load_public_key(args.builder)
    with naming(args.sealed):
        info = check(data, public)
        present = list(info.entries)
        names = list(dict.fromkeys(args.entry or present))
        for name in names:
            if name not in present:
                raise InputError(f"holds no entry {name}, only {', '.join(present)}")
        if args.out is None and len(names) > 1:
            raise InputError(f"holds {', '.join(names)}; choose one with --entry, or give a directory with --out")
        opened = open_sealed(data, reading_passwords(args, names, os.environ), public, names=names)
    for name, text in binding_facts(info.binding).items():  # standard output may be the entry itself
        print(f"{name}: {text}", file=sys.stderr)
    written = {} if args.out is None else _write(Path(args.out), opened, force=args.force)
    if args.out is None:
        sys.stdout.buffer.write(opened[names[0]])
        sys.stdout.buffer.flush()
    if args.json:
        facts = {
            name: {"bytes": len(content), "sha256": hashlib.sha256(content).hexdigest(), "written": written.get(name)}
            for name, content in opened.items()
        }
        binding = None if info.binding is None else info.binding.as_json()
        write_json(args.json, {"sealed": str(args.sealed), "entries": facts, "binding": binding})
    return 0


def _write(directory: Path, opened: dict[str, bytes], *, force: bool) -> dict[str, str]:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot be made a directory: {error.strerror}", path=directory) from error
    if not force:
        for name in opened:
            if os.path.lexists(directory / name):
                raise InputError("exists already; --force replaces it", path=directory / name)
    for name, content in opened.items():
        replace_file(directory / name, content, mode=0o600)
        print(directory / name)
    return {name: str(directory / name) for name in opened}


def run_sign(args: argparse.Namespace) -> int:
    """Sign a sealed file, or any file with a FILE.sig beside it, or make the builder's key pair; returns 0.

    Raises InputError for wrong arguments, SealedError for a file that is refused.
    """
    if args.new_key is not None:
        if args.file or args.key or args.builder or args.accept:
            raise InputError("--new-key takes no FILE or other option: sign with the new key in a second command")
        result = _new_pair(args)
    elif args.accept is not None:
        if args.file or args.key or args.builder:
            raise InputError("--accept takes no FILE, --key or --builder: it uses those of the axis file")
        result = _accept(args)
    else:
        if not args.file or not args.key:
            raise InputError("nothing to sign with: give FILE and --key, or --new-key NAME")
        result = _sign(args)
    print_facts(result)
    if args.json:
        write_json(args.json, result)
    return 0


def _new_pair(args: argparse.Namespace) -> dict[str, str]:
    private_path, public_path = f"{args.new_key}.key", f"{args.new_key}.pub"
    for path in (private_path, public_path):
        if os.path.lexists(path):
            raise InputError("exists already; a builder's key is never overwritten", path=path)
    secret = password(args.key_password_file, KEY, "password of the new key", os.environ, new=True)
    key = new_key()
    save_private_key(private_path, key, secret)
    save_public_key(public_path, key.public_key())
    return {"private": private_path, "public": public_path, "builder": fingerprint(key.public_key())}


def _accept(args: argparse.Namespace) -> dict[str, str]:
    axis = load_axis(args.accept)
    store = SealedStore.of(axis, "", password(args.key_password_file, KEY, "password of the builder's key", os.environ))
    info = store.accept()
    return {"accepted": str(store.path), "axis": axis.name, "id": info.id} | binding_facts(info.binding)


def _sign(args: argparse.Namespace) -> dict[str, str]:
    data = read_bytes(args.file)
    key = load_private_key(args.key, password(args.key_password_file, KEY, "password of the builder's key", os.environ))
    if is_sealed(data):
        present = key.public_key() if args.builder is None else load_public_key(args.builder)
        with naming(args.file):
            signed = resign(data, present, key)
        written = args.file
    else:
        signed, written = sign_detached(data, key), f"{args.file}.sig"
    replace_file(written, signed)
    return {"signed": str(args.file), "written": str(written), "builder": fingerprint(key.public_key())}


def run_check(args: argparse.Namespace) -> int:
    """Verify the builder's signature, without a password; returns 0: good; 1: not. Raises InputError for what cannot be checked."""
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
