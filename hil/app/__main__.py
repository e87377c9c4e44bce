"""Entry point of `hil` and `python -m hil.app`: imports `main` and calls it."""

import os
import signal
import sys


def run() -> int:
    """Import the program and run it; returns its exit status. During the import a Ctrl-C ends the process without a message."""
    os.umask(_umask(os.environ.get("HIL_UMASK", "")))
    ours = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # false for a process that ignores it
    if ours:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from hil.app.main import main  # noqa: PLC0415  (a Ctrl-C ends this import too)

    def loaded() -> None:
        if ours:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    return main(loaded=loaded)


def _umask(text: str) -> int:
    """The umask of files and folders written: by default all rights of group and others are withheld, as tables, results and backups
    are their owner's. text: another one in octal digits, as 022."""
    return int(text, 8) if text and set(text) <= set("01234567") else 0o077


if __name__ == "__main__":
    sys.exit(run())
