"""Who is let in: spoken to as ASGI, without a server."""

import asyncio
from collections.abc import MutableMapping
from typing import Any

import pytest

from hil.app.panel.guard import ACCESS, LOGIN, LONGEST_BODY, Guard, TokenForm
from hil.ui.screen.browsers import COOKIE

Answer = tuple[int, dict[str, str], bytes]
TOKEN = "an-access-token"
FORM = TokenForm("<form>", "not <it>", "in {seconds} s")
OURS = "https://127.0.0.1:8080"  # where there is a token there is TLS


class Inside:
    """What stands behind the guard: remembers the cookies it was shown."""

    cookies = ""

    async def __call__(self, scope: MutableMapping[str, Any], _receive: Any, send: Any) -> None:
        self.cookies = dict(scope["headers"]).get(b"cookie", b"").decode()
        if scope["type"] == "websocket":
            await send({"type": "websocket.accept"})
            return
        await send({"type": "http.response.start", "status": 200, "headers": []})
        await send({"type": "http.response.body", "body": b"inside"})


def guard(inside: Inside, token: str | None = None) -> Guard:
    return Guard(inside, ["127.0.0.1", "localhost", "::1"], token, FORM, secure=token is not None)


def ask(
    app: Guard, kind: str = "http", method: str = "GET", path: str = "/", body: bytes = b"", **headers: str
) -> Answer:
    given = {"host": "127.0.0.1:8080", **headers}
    raw = [(name.encode(), value.encode()) for name, value in given.items() if value]
    sent: list[MutableMapping[str, Any]] = []

    async def receive() -> MutableMapping[str, Any]:
        return {"type": "http.request", "body": body, "more_body": False}

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    asyncio.run(app({"type": kind, "method": method, "path": path, "headers": raw}, receive, send))
    if kind == "websocket":
        return (101 if sent[0]["type"] == "websocket.accept" else 403), {}, b""
    found = {name.decode(): value.decode() for name, value in sent[0]["headers"]}
    return int(sent[0]["status"]), found, b"".join(one.get("body", b"") for one in sent[1:])


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:1", "[::1]:8080", "LOCALHOST"])
def test_asked_for_by_a_name_of_ours(host: str) -> None:
    assert ask(guard(Inside()), host=host)[0] == 200


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:80", "", "[", "localhost@evil.example"])
def test_a_name_that_somebody_lets_point_here_is_refused(host: str) -> None:
    inside = Inside()
    assert ask(guard(inside), host=host)[0] == 421
    assert ask(guard(inside), "websocket", host=host, origin=f"http://{host}")[0] == 403
    assert inside.cookies == ""


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:9999", "http://127.0.0.1", "https://127.0.0.1:8080"]
)
@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_what_another_page_sends_is_refused(kind: str, origin: str) -> None:
    assert ask(guard(Inside()), kind, "POST", "/stop", origin=origin)[0] == 403


@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_what_our_page_sends_is_let_in(kind: str) -> None:
    assert ask(guard(Inside()), kind, "POST", "/stop", origin="http://127.0.0.1:8080")[0] in (200, 101)


def test_every_browser_gets_a_number_of_its_own_and_keeps_it() -> None:
    inside = Inside()
    app = guard(inside)
    _, headers, _ = ask(app)
    cookie = headers["set-cookie"]
    assert inside.cookies == cookie.partition(";")[0]
    assert {"HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}
    status, headers, _ = ask(app, cookie=inside.cookies)
    assert (status, "set-cookie" in headers) == (200, False)
    assert ask(guard(Inside()))[1]["set-cookie"] != cookie


@pytest.mark.parametrize("given", ["x", "", "a.b", "a" * 43, f"{'a' * 43}.{'0' * 64}"])
def test_a_number_that_the_server_did_not_issue_is_replaced(given: str) -> None:
    inside = Inside()
    app = guard(inside)
    status, headers, _ = ask(app, cookie=f"other=1; {COOKIE}={given}")
    assert status == 200
    issued = headers["set-cookie"].partition(";")[0]
    assert set(inside.cookies.split("; ")) == {"other=1", issued}
    assert issued != f"{COOKIE}={given}"
    ask(guard(inside), cookie=issued)  # of another server
    assert issued not in inside.cookies


def test_wrong_tokens_are_told_and_waited_for(caplog: pytest.LogCaptureFixture) -> None:
    app = guard(Inside(), TOKEN)
    right = f"token={TOKEN}".encode()
    answers = [ask(app, method="POST", path=LOGIN, body=b"token=wrong", origin=OURS) for _ in range(2)]
    assert [(status, body) for status, _, body in answers] == [(401, b'<form><p role="alert">not &lt;it&gt;</p>')] * 2
    assert "wrong access token from unknown, 2 in a row" in caplog.text
    status, headers, body = ask(app, method="POST", path=LOGIN, body=right, origin=OURS)
    assert (status, headers["retry-after"]) == (429, "1")  # nothing is looked at now, the right one neither
    assert body == b'<form><p role="alert">in 1 s</p>'


def test_a_proxy_of_this_computer_may_have_the_tls_that_this_server_has_not() -> None:
    """Under the name that it goes by, and under no other."""
    app = Guard(Inside(), ["127.0.0.1"], TOKEN, FORM, secure=False, proxied=["mill.example"])
    right = f"token={TOKEN}".encode()
    for host, origin, status, secure in (
        ("mill.example", "https://mill.example", 303, True),
        ("mill.example", "http://mill.example", 303, False),
        ("mill.example:8443", "https://mill.example:8443", 303, True),
        ("mill.example", "https://evil.example", 403, False),
        ("mill.example", "https://mill.example:8443", 403, False),
        ("127.0.0.1:8080", "https://127.0.0.1:8080", 403, False),
    ):
        answer = ask(app, method="POST", path=LOGIN, body=right, host=host, origin=origin)
        assert answer[0] == status, (host, origin)
        assert ("Secure" in answer[1].get("set-cookie", "")) is secure
    admitted = ask(app, method="POST", path=LOGIN, body=right, host="mill.example", origin="https://mill.example")
    cookie = admitted[1]["set-cookie"].partition(";")[0]
    assert ask(app, "websocket", host="mill.example", origin="https://mill.example", cookie=cookie)[0] == 101
    assert ask(app, "websocket", host="mill.example", origin="https://evil.example", cookie=cookie)[0] == 403


def test_a_body_that_is_too_long_is_refused_before_it_is_kept() -> None:
    """Whether its length is told or not."""

    class Reads(Inside):
        kept = 0

        async def __call__(self, scope: MutableMapping[str, Any], receive: Any, send: Any) -> None:
            while (message := await receive())["type"] == "http.request":
                self.kept += len(message["body"])
                if not message["more_body"]:
                    break
            await super().__call__(scope, receive, send)

    inside = Reads()
    told = {"origin": "http://127.0.0.1:8080", "content-length": str(LONGEST_BODY + 1)}
    assert ask(guard(inside), method="POST", **told)[0] == 413
    assert inside.kept == 0
    ask(guard(inside), method="POST", body=b"x" * (LONGEST_BODY + 1), origin="http://127.0.0.1:8080")
    assert inside.kept == 0
    ask(guard(inside), method="POST", body=b"x" * LONGEST_BODY, origin="http://127.0.0.1:8080")
    assert inside.kept == LONGEST_BODY


def test_beyond_loopback_nobody_without_the_token() -> None:
    inside = Inside()
    app = guard(inside, TOKEN)
    status, _, body = ask(app)
    assert (status, body) == (401, b"<form>")
    assert ask(app, "websocket", origin=OURS)[0] == 403
    assert ask(app, method="POST", path="/stop", origin=OURS)[0] == 401
    wrong = ask(app, method="POST", path=LOGIN, body=b"token=wrong", origin=OURS)
    assert wrong[0] == 401
    assert inside.cookies == ""
    status, headers, _ = ask(app, method="POST", path=LOGIN, body=f"token={TOKEN}".encode(), origin=OURS)
    assert (status, headers["location"]) == (303, "/")
    assert {"HttpOnly", "Secure", "SameSite=Strict"} <= {part.strip() for part in headers["set-cookie"].split(";")}
    assert ask(app, cookie=headers["set-cookie"].partition(";")[0])[2] == b"inside"
    assert ask(app, cookie=f"{ACCESS}=wrong; {COOKIE}=x")[0] == 401


LED = {"sec-fetch-mode": "navigate", "sec-fetch-dest": "document"}


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
@pytest.mark.parametrize(
    ("kind", "method", "how"),
    [
        ("http", "GET", LED | {"sec-fetch-dest": "iframe"}),
        ("http", "GET", {"sec-fetch-mode": "no-cors", "sec-fetch-dest": "script"}),
        ("http", "GET", {}),
        ("http", "POST", LED),
        ("websocket", "GET", LED),
    ],
)
def test_a_foreign_page_loads_nothing_from_here(kind: str, method: str, how: dict[str, str], site: str) -> None:
    ours = {"origin": "http://127.0.0.1:8080"}  # as from our page in all else
    assert ask(guard(Inside()), kind, method, **ours, **how)[0] in (200, 101)
    assert ask(guard(Inside()), kind, method, **ours, **how, **{"sec-fetch-site": site})[0] == 403


@pytest.mark.parametrize("site", ["cross-site", "same-site", "same-origin", "none"])
def test_a_foreign_page_may_lead_here(site: str) -> None:
    inside = Inside()
    status, headers, _ = ask(guard(inside), **LED, **{"sec-fetch-site": site})
    assert status == 200
    assert inside.cookies.startswith(COOKIE)
    assert ("set-cookie" in headers) == (site in ("same-origin", "none"))  # a number it has is not taken from it


def test_no_answer_can_be_shown_inside_another_page() -> None:
    answers = [
        ask(guard(Inside())),
        ask(guard(Inside()), cookie=f"{COOKIE}=x"),
        ask(guard(Inside()), host="evil.example"),
        ask(guard(Inside()), origin="http://evil.example"),
        ask(guard(Inside(), TOKEN)),
        ask(guard(Inside(), TOKEN), method="POST", path=LOGIN, body=f"token={TOKEN}".encode(), origin=OURS),
    ]
    assert [status for status, _, _ in answers] == [200, 200, 421, 403, 401, 303]
    for _, headers, _ in answers:
        assert headers["content-security-policy"] == "frame-ancestors 'none'"
        assert headers["x-frame-options"] == "DENY"
