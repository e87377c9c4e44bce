"""What is remembered of each browser, on the server and for as long as it runs: its language, its looks, and whether it holds control.

A browser is known by a random number in a cookie that no script can read. The tokens of control never leave the server.
"""

from __future__ import annotations

import secrets
from collections import OrderedDict
from dataclasses import dataclass, field

COOKIE = "hil-browser"
_MOST = 200


@dataclass
class Browser:
    """number: in the order of their coming; tokens: of control, by axis"""

    number: int
    language: str
    dark: bool = True
    tokens: dict[str, str] = field(default_factory=dict)


class Browsers:
    """Of one server. Only for its event loop."""

    def __init__(self, language: str) -> None:
        self._language = language
        self._known: OrderedDict[str, Browser] = OrderedDict()
        self._came = 0

    def of(self, cookie: str) -> Browser:
        """The browser with this cookie; the one not seen for longest is forgotten when they are too many."""
        if cookie not in self._known:
            self._came += 1
            self._known[cookie] = Browser(self._came, self._language)
            if len(self._known) > _MOST:
                self._known.popitem(last=False)
        self._known.move_to_end(cookie)
        return self._known[cookie]


def new_cookie() -> str:
    """A number that nobody guesses."""
    return secrets.token_urlsafe(32)
