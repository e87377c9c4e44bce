"""Settings of each browser, in the server's memory: language, colours, and tokens of control.

A browser is identified by a random number in a cookie that scripts cannot read. The tokens of control never leave the server.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets
from collections import OrderedDict
from dataclasses import dataclass, field

COOKIE = "hil-browser"
_MOST = 200


@dataclass
class Browser:
    """One browser. number: in the order of first visits; dark: dark colours; tokens: of control, by axis.

    chinese: whether its computer has a font for it, as far as known; undrawn: whether it was asked for without one
    """

    number: int
    language: str
    dark: bool = True
    chinese: bool = True
    undrawn: bool = False
    tokens: dict[str, str] = field(default_factory=dict)


class Browsers:
    """The browsers of one server, for use in its event loop only."""

    def __init__(self, language: str) -> None:
        self._language = language
        self._known: OrderedDict[str, Browser] = OrderedDict()
        self._came = 0

    def of(self, cookie: str) -> Browser:
        """The browser with this cookie. Beyond `_MOST` browsers the one not seen for longest is dropped, first of those without
        control."""
        if cookie not in self._known:
            self._came += 1
            self._known[cookie] = Browser(self._came, self._language)
            if len(self._known) > _MOST:
                plain = (number for number, browser in self._known.items() if not browser.tokens)
                del self._known[next(plain, next(iter(self._known)))]
        self._known.move_to_end(cookie)
        return self._known[cookie]


class Cookies:
    """Cookies of one server: random numbers of 256 bits, each with a code by which the server knows its own again."""

    def __init__(self) -> None:
        self._key = secrets.token_bytes(32)

    def issue(self) -> str:
        number = secrets.token_urlsafe(32)
        return f"{number}.{self._code(number)}"

    def issued(self, cookie: str) -> bool:
        number, dot, code = cookie.partition(".")
        return bool(dot) and hmac.compare_digest(code.encode(), self._code(number).encode())

    def _code(self, number: str) -> str:
        return hmac.new(self._key, number.encode(), hashlib.sha256).hexdigest()
