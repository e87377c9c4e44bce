"""`undo_all`: runs every step that puts something back, whatever fails, and reports every failure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import chain

from drivers.errors import BridgeError, UndoError

Step = tuple[str, Callable[[], None]]
"""(description for the error's line, "" where the error names it itself; the call that puts it back)."""


def undo_all(
    steps: Sequence[Step], *, during: BaseException | None = None, interrupted: Callable[[], None] = lambda: None
) -> None:
    """Try every step in the order given: first the one that is most dangerous if it is left out. Failures are reported in that order.

    One failure is raised as it is, several as an `UndoError` of one line. during: the error that caused the undoing. It is the one to
    raise, so failures are added to it as notes and nothing else is raised. An interrupt (KeyboardInterrupt) or an error that is no
    BridgeError ends its own step only: the steps after it are tried, then the first such exception is raised. interrupted: called at
    once on each such exception, before the next step: the steps may take seconds, and a stop is not to wait for them.
    """
    failures: list[tuple[str, BridgeError]] = []
    interrupt: BaseException | None = None
    for what, step in steps:
        try:
            step()
        except BridgeError as error:
            failures.append((f"{what}: {error}" if what else str(error), error))
        except BaseException as error:  # noqa: BLE001  it is raised once the other steps have been tried
            interrupt = interrupt or error
            interrupted()
    told = interrupt or during
    if told is not None:
        for line, _ in failures:
            told.add_note(line)
        if interrupt is not None:
            raise interrupt
    elif len(failures) == 1:
        raise failures[0][1]
    elif failures:
        parts = [error.errors if isinstance(error, UndoError) else (error,) for _, error in failures]
        raise UndoError("; ".join(line for line, _ in failures), tuple(chain.from_iterable(parts)))


def one_line(error: BaseException) -> str:
    """An error with the notes added to it, as one line of text."""
    texts = (str(error), *getattr(error, "__notes__", ()))
    return " ".join("; ".join(text for text in texts if text).split())
