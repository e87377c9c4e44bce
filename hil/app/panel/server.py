"""The web server: its addresses, start and end."""

from __future__ import annotations

import gc
import socket
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from importlib.resources import files
from queue import SimpleQueue
from types import FrameType

import uvicorn
from fastapi import FastAPI, Request
from fastapi.responses import JSONResponse, RedirectResponse, Response
from fastapi.staticfiles import StaticFiles
from nicegui import Client, ui
from nicegui import app as nicegui_app

from hil.app.panel.bar import Page
from hil.app.panel.elsewhere import STATIC, no_page, tell_malformed_frames_in_a_line
from hil.app.panel.frame import draw_page
from hil.app.panel.guard import LOGIN, App, Guard, TokenForm
from hil.axis.axis_file import AxisConfig, DriveAxis
from hil.backlash.job import unrestored
from hil.backlash.settings import NOTE
from hil.desk.desk import Desk
from hil.desk.unfinished import UnfinishedWork, written
from hil.parameters.job import unfinished
from hil.records.journal import Campaign
from hil.report.page import serve_reports
from hil.ui.screen.browsers import COOKIE, Browsers
from hil.ui.screen.texts import Texts
from hil.ui.screen.view import View

LOOPBACK = ("127.0.0.1", "localhost", "::1")
_FORM = (
    '<!doctype html><meta charset="utf-8"><title>hil</title><form method="post" action="{action}">'
    '<label>{label} <input type="password" name="token" autocomplete="off" autofocus></label> <button>{button}</button></form>'
)


@dataclass(frozen=True)
class ServerAccess:
    """Address and access rules of the server. tls: certificate and key file; token: access token; both None on loopback.

    names: further allowed host names.
    """

    bind: str = "127.0.0.1"
    port: int = 0
    tls: tuple[str, str] | None = None
    token: str | None = None
    names: tuple[str, ...] = ()

    @property
    def scheme(self) -> str:
        """ "http" or "https"."""
        return "http" if self.tls is None else "https"


class Server(uvicorn.Server):
    """A server that stops its axes first on SIGINT or SIGTERM.

    A thread of its own stops them: a signal interrupts the main thread anywhere, also while it holds a lock that a stop needs.
    """

    def __init__(self, config: uvicorn.Config, desks: Sequence[Desk]) -> None:
        super().__init__(config)
        self._desks = desks
        self._signals: SimpleQueue[int] = SimpleQueue()  # its put may be interrupted by another
        threading.Thread(target=self._stop_axes, name="stop", daemon=True).start()

    def _stop_axes(self) -> None:
        while True:
            self._signals.get()
            for desk in self._desks:
                desk.stop()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop all axes, and end the server."""
        self._signals.put(sig)
        super().handle_exit(sig, frame)


def serve(
    desks: Sequence[Desk], access: ServerAccess, language: str, listening: socket.socket, all_pages: Sequence[Page]
) -> None:
    """Serve until SIGINT or SIGTERM. listening: a listening socket; all_pages: in the order of the navigation."""
    app = guarded(application(desks, language, all_pages), access, language)
    cert, key = access.tls or (None, None)
    # NiceGUI searches all objects of the garbage collector for its server, which fails at one of canopen's: existing ones are hidden
    gc.freeze()
    config = uvicorn.Config(
        app,
        log_level="warning",
        ssl_certfile=cert,
        ssl_keyfile=key,
        timeout_graceful_shutdown=1,
        lifespan="on",
        server_header=False,
    )
    Server(config, desks).run(sockets=[listening])


def bound(access: ServerAccess) -> socket.socket:
    """A listening socket on the address of `access`. Raises OSError."""
    family = socket.AF_INET6 if ":" in access.bind else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((access.bind, access.port))
        listening.listen()  # connections before the server is ready wait in the backlog
    except BaseException:
        listening.close()
        raise
    return listening


def guarded(app: FastAPI, access: ServerAccess, language: str) -> App:
    """The application behind its guard."""
    t = Texts(language)
    page = _FORM.format(action=LOGIN, label=escape(t("access.token")), button=escape(t("go.screen")))
    form = TokenForm(page, t("access.wrong"), t("access.wait"))
    hosts = [*LOOPBACK, access.bind]
    return Guard(app, hosts, access.token, form, secure=access.tls is not None, proxied=access.names)


def application(desks: Sequence[Desk], language: str, all_pages: Sequence[Page]) -> FastAPI:
    """All addresses: the stop, the pages of each axis, and what they load."""
    app = FastAPI(openapi_url=None)
    browsers = Browsers(language)
    by_name = {desk.name: desk for desk in desks}
    home = f"/axis/{desks[0].name}/{all_pages[0].name}"
    unfinished = partial(unfinished_work, pages=all_pages)

    @app.post("/stop")
    async def stop(request: Request) -> JSONResponse:
        for desk in desks:  # all, before anything else
            desk.stop()
        browser = browsers.of(request.cookies.get(COOKIE, ""))
        who = Texts(browser.language)("control.browser", number=browser.number)
        for desk in desks:
            desk.told_stop(who)
        return JSONResponse({"stopped": list(by_name)})

    @app.get("/")
    async def begin() -> RedirectResponse:
        return RedirectResponse(home)

    @ui.page("/axis/{axis}/{name}")
    def show(request: Request, client: Client, axis: str, name: str) -> Response | None:
        browser = browsers.of(request.cookies.get(COOKIE, ""))
        t = Texts(browser.language)
        page = next((one for one in all_pages if one.name == name), None)
        if axis not in by_name or page is None:
            return no_page(t, home)
        draw_page(View(by_name[axis], desks, t, browser, client, unfinished), page, all_pages)
        return None

    async def not_found(request: Request, _error: Exception) -> Response:
        return no_page(Texts(browsers.of(request.cookies.get(COOKIE, "")).language), home)

    nicegui_app.add_exception_handler(404, not_found)
    nicegui_app.on_startup(lambda: tell_malformed_frames_in_a_line(desks[0].errors))
    serve_reports(app, by_name)
    app.mount(STATIC, StaticFiles(directory=str(files("hil.app.panel") / "static")), name="static")
    ui.add_head_html(f'<link rel="stylesheet" href="{STATIC}/panel.css">', shared=True)
    ui.add_head_html(f'<script src="{STATIC}/panel.js"></script>', shared=True)
    # a browser that reconnects within this time keeps its page; later it loads the page again
    ui.run_with(app, title="hil", show_welcome_message=False, reconnect_timeout=30.0, tailwind=False)
    return app


SETTINGS = "settings"
DOWNLOAD = "download"


def unfinished_work(axis: DriveAxis, pages: Sequence[Page]) -> tuple[UnfinishedWork, ...]:
    """All interrupted work of an axis that one of the pages goes on with. Reads its folder."""
    directory = axis.store.directory
    found = []
    resumed = {kind: page.name for page in pages for kind in page.resumes}
    for kind, page in resumed.items() if isinstance(axis, AxisConfig) else ():
        campaign = Campaign.unfinished(directory, kind)
        if campaign is not None:
            place = campaign.directory
            found.append(UnfinishedWork(kind, page, place.name, written(place), campaign.rows))
    if unrestored(axis):
        found.append(UnfinishedWork(SETTINGS, "backlash", directory.name, written(directory / NOTE)))
    download = unfinished(axis)
    if download is not None:
        found.append(UnfinishedWork(DOWNLOAD, "parameters", download.set_name, written(download.path)))
    return tuple(found)
