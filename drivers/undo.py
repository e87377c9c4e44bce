"""`undo_all`: what is undone on the way out is undone to the end, and every failure is told."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from drivers.errors import BridgeError, UndoError

Step = tuple[str, Callable[[], None]]
"""What is undone, for the error's line ("" where the error says it itself), and the call that does it."""


def undo_all(steps: Sequence[Step], *, during: BaseException | None = None) -> None:
    """Try every step, in the order given: first what is most dangerous if it is left undone. Failures are told in that order.

    One failure is raised as it is, several as an `UndoError` of one line. during: the error that led here. It is the one to raise,
    so failures are added to it as notes and nothing else is raised. An interrupt (KeyboardInterrupt) or an error that is no
    BridgeError ends its step only: the steps after it are tried, then the first such exception is raised.
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
    told = interrupt or during
    if told is not None:
        for line, _ in failures:
            told.add_note(line)
        if interrupt is not None:
            raise interrupt
    elif len(failures) == 1:
        raise failures[0][1]
    elif failures:
        raise UndoError("; ".join(line for line, _ in failures), tuple(error for _, error in failures))


def one_line(error: BaseException) -> str:
    """An error with what was added to it on the way out, as one line for a person."""
    texts = (str(error), *getattr(error, "__notes__", ()))
    return " ".join("; ".join(text for text in texts if text).split())
