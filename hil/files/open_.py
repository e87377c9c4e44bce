"""`hil open`: decrypts a sealed file with its reading password."""

from __future__ import annotations

import argparse
import hashlib
import os
import sys
from pathlib import Path

from drivers.errors import InputError
from drivers.files import read_bytes, replace_file
from hil.correction.sealed import check, load_public_key, open_sealed
from hil.records.files import naming
from hil.ui.terminal.output import binding_facts, write_json
from hil.ui.terminal.passwords import reading_passwords


def run(args: argparse.Namespace) -> int:
    """Exit status 0. Raises SealedError for a file that is refused, InputError for wrong arguments."""
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
