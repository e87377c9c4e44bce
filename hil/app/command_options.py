"""Options of `hil demo` and `hil panel`."""

from __future__ import annotations

from hil.ui.terminal.options import Later, Subparsers, add_json_option, number_type, seed, verb_parser, whole_type

_PACE = number_type("a number >= 0", lambda value: 0.0 <= value <= 1e6)

# -- hil demo ----------------------------------------------------------------------------------------------------------
DEMO_EXAMPLE = """\
example:
  hil demo
  hil demo --out /tmp/demo --seed 7     another machine

A CiA-402 drive on a virtual CAN bus and a laser on a pseudo-terminal, over a simulated screw axis. It is calibrated cold; warm, it
shows an error that no table holds. The loop finds its cause, adds it to the correction, and measures again.
"""


def add_demo(subparsers: Subparsers) -> None:
    parser = verb_parser(
        subparsers,
        "demo",
        "Calibrate, verify, diagnose, extend and verify again, on a simulated machine over real protocols.",
        DEMO_EXAMPLE,
    )
    parser.add_argument("--out", metavar="DIR", default="hil-demo", help="where to put everything (default hil-demo)")
    parser.add_argument("--seed", type=seed, help="another simulated machine")
    add_json_option(parser)
    parser.set_defaults(run=Later("hil.app.demo"))


# -- hil panel ---------------------------------------------------------------------------------------------------------
PANEL_EXAMPLE = """\
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


def add_panel(subparsers: Subparsers) -> None:
    parser = verb_parser(subparsers, "panel", "Serve the operator's screen of one or several axes.", PANEL_EXAMPLE)
    parser.add_argument("axes", metavar="AXIS.toml", nargs="+", help="an axis file each")
    parser.add_argument("--probe", metavar="MACHINE.toml", help="the machine file of a touch probe, for its page")
    parser.add_argument(
        "--run",
        dest="run_file",
        metavar="PROCEDURE.py",
        help="a measuring procedure of yours (hil run), for a page of its own",
    )
    parser.add_argument(
        "--port",
        type=whole_type(0, 65535, "a port, 0 to 65535"),
        default=0,
        help="TCP port (default 0: any free one, which is printed)",
    )
    parser.add_argument("--pace", type=_PACE, default=1.0, help="of jobs on the bench against real time (default 1)")
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
    parser.set_defaults(run=Later("hil.app.panel.command"))
