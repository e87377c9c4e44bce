"""`hil sign`: signs a sealed file, or any file with a FILE.sig beside it; makes the builder's key pair."""

from __future__ import annotations

import argparse
import os

from drivers.errors import InputError
from drivers.files import read_bytes, replace_file
from hil.axis.axis_file import load_axis
from hil.correction.sealed import (
    fingerprint,
    is_sealed,
    load_private_key,
    load_public_key,
    new_key,
    resign,
    save_private_key,
    save_public_key,
    sign_detached,
)
from hil.correction.store import SealedStore
from hil.records.files import naming
from hil.ui.terminal.options import KEY
from hil.ui.terminal.output import binding_facts, print_facts, write_json
from hil.ui.terminal.passwords import password


def run(args: argparse.Namespace) -> int:
    """Sign, or make a key pair; exit status 0. Raises InputError for wrong arguments, SealedError for a file that is refused."""
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
