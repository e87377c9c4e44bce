"""`hil panel`: the operator's screen in a browser."""

from __future__ import annotations

import argparse
import itertools
import math
import secrets
import string
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from drivers.errors import InputError
from drivers.files import replace_file
from hil.axis.axis_file import DriveAxis, load_drive_axis
from hil.probe.machine_file import load_probe_machine
from hil.ui.terminal.passwords import read_password_file

LOOPBACK = ("127.0.0.1", "localhost", "::1")
TOKEN_BITS = 128
"""Fewest bits of an access token, as NIST SP 800-63B asks at least 64 of a session secret: a guess every microsecond never ends."""


def run(args: argparse.Namespace) -> int:
    """Serve until SIGINT or SIGTERM; exit status 0. Raises InputError for wrong arguments or a missing panel extra."""
    axes = [load_drive_axis(path) for path in args.axes]
    _check_names(axes)
    probe = None if args.probe is None else load_probe_machine(args.probe)
    procedure = None
    if args.run_file is not None:
        from hil.script.procedure_file import load_procedure  # noqa: PLC0415  (loads the user's code)

        procedure = load_procedure(args.run_file)
    tls, token = _access(args)
    try:
        from hil.app.panel import pages, server  # noqa: PLC0415  (an extra, and seconds of imports)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("nicegui", "fastapi", "uvicorn", "starlette"):
            raise
        raise InputError("the screen needs the panel extra: pip install 'hil[panel]'") from error
    from hil.desk.desk import Desk  # noqa: PLC0415

    access = server.ServerAccess(args.bind, args.port, tls, token, tuple(args.name))
    with server.bound(access) as listening, ExitStack() as stack:
        numbers = itertools.count(1)
        desks = [stack.enter_context(Desk(axis, pace=args.pace, numbers=numbers)) for axis in axes]
        for desk in desks:
            stack.callback(desk.stop)  # on any end of the server all are stopped before any is waited for
        host = f"[{access.bind}]" if ":" in access.bind else access.bind
        print(f"{access.scheme}://{host}:{listening.getsockname()[1]}/", flush=True)
        if token is not None and not args.token_file:
            print(f"access token: {token}", flush=True)
        try:
            server.serve(desks, access, args.lang, listening, pages.pages(probe, procedure))
        except KeyboardInterrupt:
            print("hil: the axes were stopped, what was measured is kept", file=sys.stderr)
    return 0


def _check_names(axes: Sequence[DriveAxis]) -> None:
    names = [axis.name for axis in axes]
    if len(set(names)) < len(names):
        raise InputError(f"axes {', '.join(names)}: expected a name for each")


def _access(args: argparse.Namespace) -> tuple[tuple[str, str] | None, str | None]:
    """Certificate and key, and the access token. Raises InputError for an address beyond loopback without a certificate."""
    if (args.cert is None) != (args.key is None):
        raise InputError("--cert and --key go together")
    tls = None if args.cert is None else (args.cert, args.key)
    for path in tls or ():
        if not Path(path).is_file():
            raise InputError("is not there", path=path)
    if args.bind in LOOPBACK and not args.name:
        return tls, None
    if tls is None and args.bind not in LOOPBACK:
        raise InputError(
            f"--bind {args.bind} is not loopback, expected --cert and --key: others could read and change what is sent"
        )
    return tls, _token(Path(args.token_file)) if args.token_file else secrets.token_urlsafe(TOKEN_BITS // 8)


def _token(path: Path) -> str:
    """The access token in a file, which is made where it is not there. Raises InputError for one that others can read, or that has
    fewer than `TOKEN_BITS` bits by its length and kinds of characters."""
    if not path.exists():
        replace_file(path, f"{secrets.token_urlsafe(TOKEN_BITS // 8)}\n".encode(), mode=0o600)
    mode = path.stat().st_mode
    if mode & 0o077:
        raise InputError(f"has the mode {mode & 0o777:o}, expected 600: others can read the access token", path=path)
    token = read_password_file(path)
    kinds = (string.ascii_lowercase, string.ascii_uppercase, string.digits)
    alphabet = sum(len(kind) for kind in kinds if set(kind) & set(token)) + 8 * bool(set(token) - set("".join(kinds)))
    if set(token.lower()) <= set(string.hexdigits):
        alphabet = 16
    bits = len(token) * math.log2(alphabet) if len(set(token)) > 1 else 0.0
    if bits < TOKEN_BITS:
        raise InputError(f"holds a token of {bits:.0f} bits at most, expected {TOKEN_BITS}", path=path)
    return token
