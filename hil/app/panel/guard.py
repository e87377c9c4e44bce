"""Access control of the server: an ASGI layer around the whole application, web sockets included.

A request is answered only if it names this server (Host) and comes from a page of this server (Origin). So a foreign page in the same
browser can neither send requests here nor use a name that it resolves to this machine (DNS rebinding). It cannot load anything from
here or embed the screen; it can only link to it (Sec-Fetch-Site). Beyond loopback a browser needs the access token first.
"""

from __future__ import annotations

import hmac
import logging
import secrets
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from dataclasses import dataclass
from html import escape
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

from hil.desk.backoff import BackOff
from hil.ui.screen.browsers import COOKIE, Cookies

Message = MutableMapping[str, Any]
Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

ACCESS = "hil-access"
LOGIN = "/access"
_LONGEST_FORM = 4096
LONGEST_BODY = 4_000_000
"""Longest body of a request, bytes: twice the largest file that a page takes. It is counted as it comes, before anything is kept."""
_LOG = logging.getLogger("hil.panel")
_HTML = [("content-type", "text/html; charset=utf-8")]
_UNFRAMED = ((b"content-security-policy", b"frame-ancestors 'none'"), (b"x-frame-options", b"DENY"))
_FOREIGN = ("cross-site", "same-site")
"""Values of Sec-Fetch-Site for a request by a page of another site, or of another server on the same machine."""


@dataclass(frozen=True)
class TokenForm:
    """What a browser without the token is shown. page: HTML that asks for it; wrong: said of a wrong one; wait: said while none is
    looked at, with {seconds}."""

    page: str
    wrong: str = ""
    wait: str = "{seconds}"

    def after_wrong(self) -> str:
        """The page after a wrong token."""
        return f'{self.page}<p role="alert">{escape(self.wrong)}</p>'

    def waiting(self, seconds: int) -> str:
        """The page while no token is looked at."""
        return f'{self.page}<p role="alert">{escape(self.wait.format(seconds=seconds))}</p>'


class Guard:
    """The layer. hosts: allowed host names, without port; proxied: further ones, of a proxy on this computer, whose pages may come by
    TLS though this server has none; access_token: None on loopback; form: what asks for the token."""

    def __init__(
        self,
        app: App,
        hosts: Iterable[str],
        access_token: str | None,
        form: TokenForm,
        *,
        secure: bool,
        proxied: Iterable[str] = (),
    ) -> None:
        self.app = app
        self._proxied = frozenset(host.lower() for host in proxied)
        self._hosts = frozenset(host.lower() for host in hosts) | self._proxied
        self._token = access_token
        self._cookies = Cookies()
        self._backoff = BackOff()
        self._admission = secrets.token_urlsafe(32)  # value of the cookie of an admitted browser
        self._form = form
        self._scheme = "https" if secure else "http"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return

        async def unframed(message: Message) -> None:
            await send(_with_headers(message, *_UNFRAMED))

        await self._let_in(scope, receive, unframed)

    async def _let_in(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        if _host_name(headers.get("host", "")) not in self._hosts:
            await _refuse(scope, send, 421, "this server does not go by that name")
        elif not self._from_our_page(scope, headers):
            await _refuse(scope, send, 403, "not from a page of this server")
        elif not self._admitted(headers):
            await self._ask(scope, headers, receive, send)
        else:
            await self._pass_on(scope, headers, receive, send)

    def _from_our_page(self, scope: Scope, headers: dict[str, str]) -> bool:
        """Whether the request comes from a page of this server. GET and HEAD need no Origin, as a browser sends none with a visit;
        other requests need this server's. A foreign page may only link here."""
        if headers.get("sec-fetch-site") in _FOREIGN and not _leads_here(scope, headers):
            return False
        origin = headers.get("origin")
        if origin is None:
            return scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        scheme, _, host = origin.lower().partition("://")
        by_tls = scheme == "https" and _host_name(headers.get("host", "")) in self._proxied
        return (scheme == self._scheme or by_tls) and host == headers.get("host", "").lower()

    def _flags(self, headers: dict[str, str]) -> str:
        """Flags of a cookie: for TLS alone where the request came by it, to this server or to its proxy."""
        told = headers.get("origin", "").startswith("https:") or headers.get("x-forwarded-proto", "") == "https"
        by_tls = self._scheme == "https" or (told and _host_name(headers.get("host", "")) in self._proxied)
        return "; Path=/; HttpOnly; SameSite=Strict" + ("; Secure" if by_tls else "")

    def _admitted(self, headers: dict[str, str]) -> bool:
        if self._token is None:
            return True
        given = cookies(headers).get(ACCESS, "")
        return hmac.compare_digest(given.encode(), self._admission.encode())

    async def _ask(self, scope: Scope, headers: dict[str, str], receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await _refuse(scope, send, 401, "")
            return
        if scope["path"] == LOGIN and scope["method"] == "POST":
            address = str((scope.get("client") or ("unknown",))[0])
            wait_s = self._backoff.wait_s(address)
            if wait_s > 0.0:
                seconds = int(wait_s) + 1
                await _answer(send, 429, self._form.waiting(seconds), [*_HTML, ("retry-after", str(seconds))])
                return
            given = parse_qs((await _body(receive)).decode("utf-8", "replace")).get("token", [""])[0]
            if self._token is not None and hmac.compare_digest(given.encode(), self._token.encode()):
                self._backoff.right(address)
                cookie = f"{ACCESS}={self._admission}{self._flags(headers)}"
                await _answer(send, 303, "", [("location", "/"), ("set-cookie", cookie)])
                return
            _LOG.warning("wrong access token from %s, %d in a row", address, self._backoff.wrong(address))
            await _answer(send, 401, self._form.after_wrong(), _HTML)
            return
        await _answer(send, 401, self._form.page, _HTML)

    async def _pass_on(self, scope: Scope, headers: dict[str, str], receive: Receive, send: Send) -> None:
        """Pass the request on. A browser without a cookie of this server's own gets one.

        A browser that follows a foreign page's link does not send its cookie: it gets one for this request only, and keeps its own.
        """
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > LONGEST_BODY:
            await _refuse(scope, send, 413, f"expected at most {LONGEST_BODY} bytes")
            return
        receive = _limited(receive)
        given = cookies(headers)
        if self._cookies.issued(given.get(COOKIE, "")):
            await self.app(scope, receive, send)
            return
        cookie = self._cookies.issue()
        pair = "; ".join(f"{name}={value}" for name, value in {**given, COOKIE: cookie}.items())
        others = [(name, value) for name, value in scope["headers"] if name != b"cookie"]
        numbered = {**scope, "headers": [*others, (b"cookie", pair.encode("latin-1"))]}

        async def with_cookie(message: Message) -> None:
            flags = f"{COOKIE}={cookie}{self._flags(headers)}"
            await send(_with_headers(message, (b"set-cookie", flags.encode("latin-1"))))

        await self.app(numbered, receive, send if headers.get("sec-fetch-site") in _FOREIGN else with_cookie)


def cookies(headers: dict[str, str]) -> dict[str, str]:
    """The cookies of a request by name; empty for a malformed header."""
    try:
        return {name: morsel.value for name, morsel in SimpleCookie(headers.get("cookie", "")).items()}
    except CookieError:
        return {}


def _leads_here(scope: Scope, headers: dict[str, str]) -> bool:
    """Whether the request is a top-level navigation; a frame's destination is not "document"."""
    how = headers.get("sec-fetch-mode"), headers.get("sec-fetch-dest")
    return how == ("navigate", "document") and scope["type"] == "http" and scope["method"] == "GET"


def _with_headers(message: Message, *headers: tuple[bytes, bytes]) -> Message:
    """A response start with these headers added; any other message unchanged."""
    if message["type"] != "http.response.start":
        return message
    return {**message, "headers": [*message.get("headers", []), *headers]}


def _host_name(host: str) -> str:
    """The host without its port; "" for a malformed one."""
    try:
        return (urlsplit(f"//{host}").hostname or "").lower()
    except ValueError:
        return ""


def _limited(receive: Receive) -> Receive:
    """The body of a request up to `LONGEST_BODY`; a longer one, whose length was not told, is cut off as if its sender had left."""
    came = 0

    async def counted() -> Message:
        nonlocal came
        message = await receive()
        came += len(message.get("body", b""))
        return {"type": "http.disconnect"} if came > LONGEST_BODY else message

    return counted


async def _body(receive: Receive) -> bytes:
    body = b""
    while len(body) <= _LONGEST_FORM:
        message = await receive()
        body += message.get("body", b"")
        if not message.get("more_body", False):
            break
    return body[:_LONGEST_FORM]


async def _refuse(scope: Scope, send: Send, status: int, why: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008})
        return
    await _answer(send, status, why, [("content-type", "text/plain; charset=utf-8")])


async def _answer(send: Send, status: int, text: str, headers: list[tuple[str, str]]) -> None:
    raw = [(name.encode("latin-1"), value.encode("latin-1")) for name, value in headers]
    await send({"type": "http.response.start", "status": status, "headers": raw})
    await send({"type": "http.response.body", "body": text.encode()})
