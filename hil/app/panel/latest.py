"""What is on the screen already, so that a refresh draws a result once."""

from __future__ import annotations


class Latest:
    """One place on a page where results are shown. Results are told apart as objects, not by what is in them."""

    def __init__(self) -> None:
        self._shown: object = None

    def is_new(self, result: object) -> bool:
        """Whether this one is not shown yet; from now on it is. Nothing to show (None) is never new."""
        new = result is not None and result is not self._shown
        self._shown = result if new else self._shown
        return new
