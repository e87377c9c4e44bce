"""Answers beside the pages: addresses that are no page, with STOP and a way back, and what a malformed frame leaves in the log."""

from __future__ import annotations

import asyncio
import logging
import traceback
from html import escape
from pathlib import Path
from typing import Any

import engineio  # type: ignore[import-untyped]
import nicegui
import socketio  # type: ignore[import-untyped]
from fastapi.responses import HTMLResponse

from hil.desk.error_log import ErrorLog
from hil.ui.screen.texts import Texts

STATIC = "/hil-static"
_OURS = Path(__file__).parents[2]
_LOG = logging.getLogger("hil.panel")
_WIRE = tuple(Path(str(one.__file__)).parent for one in (engineio, socketio, nicegui))
"""Packages that read what browsers send. An error that is raised in one of them is of the frame, not of this program."""


def no_page(t: Texts, home: str) -> HTMLResponse:
    """A page without a socket: the address is no page. It stops as every page does. home: address of the first axis's page."""
    return HTMLResponse(
        f'<!doctype html><html lang="{t.language}"><meta charset="utf-8"><title>hil</title>'
        f'<link rel="stylesheet" href="{STATIC}/panel.css"><script src="{STATIC}/panel.js"></script>'
        f'<body class="body--dark hil-alone">'
        f'<div data-name="stop-lost" class="hil-lost" role="alert" hidden>{escape(t("stop.lost"))}</div>'
        f'<button data-name="stop" aria-label="{escape(t("stop.hint"))}"><div>{escape(t("stop.stop"))}</div>'
        f"<small>{escape(t('stop.keys'))}</small></button>"
        f'<p data-name="no-page">{escape(t("header.no_page"))}</p>'
        f'<p><a data-name="home" href="{escape(home)}">{escape(t("header.home"))}</a></p></body></html>',
        status_code=404,
    )


def tell_malformed_frames_in_a_line(errors: ErrorLog) -> None:
    """For the server's event loop, which has to run: no traceback for what a browser sent; a program error goes to `errors`."""
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: _tell(context, errors))
    for logger in ("engineio.server", "uvicorn.error"):
        logging.getLogger(logger).addFilter(_one_line)


def _tell(context: dict[str, Any], errors: ErrorLog) -> None:
    error = context.get("exception")
    if error is None:
        _LOG.warning("%s", context.get("message", ""))
    elif _of_a_frame(error):
        _LOG.warning("a malformed frame was dropped: %s", type(error).__name__)
    else:
        _LOG.error("%s", errors.line_of(error))


def _of_a_frame(error: BaseException) -> bool:
    """Whether the innermost code that is this program's or reads frames is the latter."""
    frames = [Path(one.filename) for one in traceback.extract_tb(error.__traceback__)]
    known = [_is_wire(path) for path in frames if _is_wire(path) or path.is_relative_to(_OURS)]
    return bool(known) and known[-1]


def _is_wire(path: Path) -> bool:
    return any(path.is_relative_to(package) for package in _WIRE)


def _one_line(record: logging.LogRecord) -> bool:
    if record.exc_info and record.exc_info[1] is not None and _of_a_frame(record.exc_info[1]):
        record.msg, record.args = "a malformed frame was dropped: %s", (type(record.exc_info[1]).__name__,)
        record.exc_info = record.exc_text = None
    return True
