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

EXAMPLE = """\
example:
  hil panel X.toml                                  prints the address; open it in a browser on this machine
  hil panel X.toml Y.toml --port 8080 --lang de     several axes, German
  hil panel X.toml Y.toml --probe MACHINE.toml      and the touch probe of the machine
  hil panel X.toml --run creep.py                   and a measuring procedure of yours (hil help scripts)
  hil panel X.toml --pace 10                        on the bench, jobs run ten times as fast as a machine (0: as fast as they go)
  hil panel X.toml --bind 192.0.2.7 --cert server.crt --key server.key     for other machines: TLS, and a token for every browser

  hil panel X.toml --name mill.example --token-file TOKEN     behind a proxy of this machine: a token too, made in TOKEN

Only loopback is served unless --bind says otherwise. One browser at a time holds control; every browser can stop. Closing browsers
stops nothing: a measurement goes on, and what it measured is kept. Ctrl-C here stops the axes and ends the server. The stop is a quick
stop by the drive, which is no safety function. Needs the panel extra: pip install 'hil[panel]'.
"""
LANGUAGES = ("en", "de", "zh")
LOOPBACK = ("127.0.0.1", "localhost", "::1")
TOKEN_BITS = 128
"""Fewest bits of an access token, as NIST SP 800-63B asks at least 64 of a session secret: a guess every microsecond never ends."""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `hil panel`."""
    parser = subparsers.add_parser(
        "panel",
        description="Serve the operator's screen of one or several axes.",
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("axes", metavar="AXIS.toml", nargs="+", help="an axis file each")
    parser.add_argument("--probe", metavar="MACHINE.toml", help="the machine file of a touch probe, for its page")
    parser.add_argument(
        "--run",
        dest="run_file",
        metavar="PROCEDURE.py",
        help="a measuring procedure of yours (hil run), for a page of its own",
    )
    parser.add_argument("--port", type=_port, default=0, help="TCP port (default 0: any free one, which is printed)")
    parser.add_argument("--pace", type=_pace, default=1.0, help="of jobs on the bench against real time (default 1)")
    parser.add_argument("--lang", choices=LANGUAGES, default="en", help="language of a new browser (default en)")
    parser.add_argument(
        "--bind", metavar="ADDRESS", default="127.0.0.1", help="address to listen on (default 127.0.0.1)"
    )
    parser.add_argument(
        "--name",
        metavar="HOST",
        action="append",
        default=[],
        help="a host name browsers may use, who then need the token; repeat",
    )
    parser.add_argument("--cert", metavar="FILE", help="certificate, for an address that is not loopback")
    parser.add_argument("--key", metavar="FILE", help="its private key")
    parser.add_argument(
        "--token-file",
        metavar="F",
        help="file with the access token, mode 600, made if it is not there (else one is made and printed)",
    )
    parser.set_defaults(run=run)


def _port(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and int(text) < 65536):
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a port, 0 to 65535")
    return int(text)


def _pace(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1e6:
        raise argparse.ArgumentTypeError(f"is {text!r}, expected a number >= 0")
    return value


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

    access = server.Access(args.bind, args.port, tls, token, tuple(args.name))
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
