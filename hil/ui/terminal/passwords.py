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
from drivers.files import read_text
from hil.correction.sealed.errors import WrongKeyPasswordError, WrongPasswordError
from hil.correction.sealed.keys import NEW_CHARACTERS, require_strong
from hil.records.files import split_lines
from hil.ui.terminal.options import KEY, READING

MOST_BYTES = 1 << 20
"""Longest password file."""
MEANING = {
    READING: "opens the sealed tables; whoever made them chose it (`hil demo` writes its own to hil-demo/password)",
    KEY: "opens the builder's private key, with which tables, reports and certificates are signed; it was chosen with"
    " `hil sign --new-key`",
}
"""What each password is for, told where it is asked for."""
NEW_MEANING = {
    READING: "will open the sealed file",
    KEY: "will open the builder's private key, with which tables, reports and certificates are signed",
}
"""The same of a password that is chosen now."""


def read_password_file(path: str | Path) -> str:
    """The first line of a file. Raises InputError when it cannot be read or is empty."""
    lines = split_lines(read_text(path, MOST_BYTES, expected="a password on the first line"))
    if not lines or not lines[0]:
        raise InputError("holds no password, expected one on its first line", path=path)
    return lines[0]


def password_source(error: InputError, args: argparse.Namespace, environment: Mapping[str, str]) -> str:
    """Where `password` took a wrong password from, to be added to the error's line; "" for other errors, and where an entry or a table
    may have its own.
    """
    key = isinstance(error, WrongKeyPasswordError)
    own = getattr(args, "table_password", None) or getattr(args, "entry_password", None)
    if not isinstance(error, WrongPasswordError) or (own and not key):
        return ""
    option, variable = ("key_password_file", KEY) if key else ("password_file", READING)
    flag = f"--{option.replace('_', '-')}"
    if file := getattr(args, option, None):
        return f"; the password is that of {flag} {file}"
    if environment.get(variable):
        return (
            f"; the password is that of {variable} in the environment, which goes before {option} of an axis file: unset it, or"
            f" give {flag} FILE"
        )
    named = getattr(args, "axis", None) or getattr(args, "axis_file", None)
    return f"; the password is that of {option} of {named}, or was typed where that names none" if named else ""


def password(
    file: str | None,
    variable: str,
    what: str,
    environment: Mapping[str, str],
    *,
    new: bool = False,
    usual: Path | None = None,
) -> str:
    """One password: from `file`, else the environment's `variable`, else the file `usual`, else asked for (`new`: twice).

    Raises InputError where there is none, for an empty one, and for one of a new key that is typed and too weak.
    """
    if file is not None:
        return read_password_file(file)
    if environment.get(variable):
        return environment[variable]
    if usual is not None:
        return read_password_file(usual)
    meaning = (NEW_MEANING if new else MEANING)[variable]
    if not sys.stdin.isatty():
        option = "--key-password-file" if variable == KEY else "--password-file"
        raise InputError(f"no {what}: give {option} FILE or set {variable}; it {meaning}")
    print(f"the {what} {meaning}", file=sys.stderr)
    if new:
        print(
            f"choose one of at least {NEW_CHARACTERS} characters, and keep it: a lost password cannot be recovered",
            file=sys.stderr,
        )
    first = asked(f"{what}: ", what)
    if not first:
        raise InputError(f"{what} is empty, expected at least one character")
    if new and variable == KEY:  # a reading password may be that of entries that exist, which `hil seal --update` keeps
        require_strong(first, what)
    if new and asked(f"{what}, again: ", what) != first:
        raise InputError(f"{what}: the two entries differ")
    return first


def asked(prompt: str, what: str) -> str:
    """What is typed at a prompt, unseen. Raises InputError where the input ends there (Ctrl-D)."""
    try:
        return getpass.getpass(prompt)
    except EOFError as error:
        raise InputError(f"no {what}: the input ended at its prompt (Ctrl-D); nothing was moved or written") from error


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
