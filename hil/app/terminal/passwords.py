"""Passwords from a file, the environment or the keyboard; never from the command line, which other users can read.

The environment is a parameter of every function that uses it.
"""

from __future__ import annotations

import argparse
import getpass
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from drivers.errors import InputError

READING = "HIL_PASSWORD"
KEY = "HIL_KEY_PASSWORD"


def add_reading_options(parser: argparse.ArgumentParser) -> None:
    """Options for the password(s) of the entries of a sealed file."""
    parser.add_argument(
        "--password-file",
        metavar="F",
        help=f"file whose first line is the reading password (else ${READING}, else asked)",
    )
    parser.add_argument(
        "--entry-password",
        metavar="NAME=F",
        action="append",
        default=[],
        help="an own password for one entry, from the first line of file F; may be repeated",
    )


def add_key_options(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Options for the builder's private key and its password."""
    parser.add_argument("--key", metavar="BUILDER.key", required=required, help="the builder's private key")
    parser.add_argument(
        "--key-password-file",
        metavar="F",
        help=f"file whose first line is the key's password (else ${KEY}, else asked)",
    )


def read_password_file(path: str | Path) -> str:
    """The first line of a file. Raises InputError when it cannot be read or is empty."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}", path=path) from error
    except UnicodeDecodeError as error:
        raise InputError("is not UTF-8 text", path=path) from error
    if not lines or not lines[0]:
        raise InputError("holds no password, expected one on its first line", path=path)
    return lines[0]


def password(file: str | None, variable: str, what: str, environment: Mapping[str, str], *, new: bool = False) -> str:
    """One password: from `file`, else the environment's `variable`, else asked for (`new`: twice) on a terminal.

    Raises InputError where there is none, or for an empty one.
    """
    if file is not None:
        return read_password_file(file)
    if environment.get(variable):
        return environment[variable]
    if not sys.stdin.isatty():
        raise InputError(f"no {what}: give a password file or set {variable}")
    first = getpass.getpass(f"{what}: ")
    if not first:
        raise InputError(f"{what} is empty, expected at least one character")
    if new and getpass.getpass(f"{what}, again: ") != first:
        raise InputError(f"{what}: the two entries differ")
    return first


def own_passwords(texts: Sequence[str], names: Sequence[str], option: str) -> dict[str, str]:
    """Passwords of single entries or tables given as NAME=FILE. Raises InputError for another form or name."""
    passwords: dict[str, str] = {}
    for text in texts:
        name, separator, file = text.partition("=")
        if not separator or not name or not file:
            raise InputError(f"{option} is {text!r}, expected NAME=FILE")
        if name not in names:
            raise InputError(f"{option} names entry {name}, expected one of {', '.join(names)}")
        passwords[name] = read_password_file(file)
    return passwords


def reading_passwords(
    args: argparse.Namespace, names: list[str], environment: Mapping[str, str], *, new: bool = False
) -> dict[str, str]:
    """The password of each entry in `names`: its own where given, the common one for the others (asked for only if needed).

    Raises InputError for a wrong `--entry-password`, and as `password`.
    """
    passwords = own_passwords(args.entry_password, names, "--entry-password")
    if rest := [name for name in names if name not in passwords]:
        common = password(args.password_file, READING, "reading password", environment, new=new)
        passwords |= dict.fromkeys(rest, common)
    return passwords
