"""`hil` and `python -m hil.app`: the way in, up to where `main` is loaded and takes over."""

import signal
import sys


def run() -> int:
    """Load the program and run it. While it loads nothing moves: a Ctrl-C that comes then ends the process without a word."""
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # not: a job that was told to ignore it
    if ours:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from hil.app.terminal.main import load_verb, main  # noqa: PLC0415  (seconds of imports)

    load_verb(sys.argv[1:])

    if ours:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return main()


if __name__ == "__main__":
    sys.exit(run())
