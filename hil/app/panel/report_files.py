"""Serves the reports of the axes as files, to open or to save. No other file of a folder is served."""

from __future__ import annotations

from collections.abc import Mapping

from fastapi import FastAPI
from fastapi.responses import FileResponse, PlainTextResponse, Response

from hil.desk.desk import Desk
from hil.report.job import FOLDER, NAME

ALONE = {"Content-Security-Policy": "sandbox allow-scripts allow-modals", "X-Content-Type-Options": "nosniff"}
"""Headers that keep a report's page from the screen's cookies and from requests to the server."""


def serve_reports(app: FastAPI, desks: Mapping[str, Desk]) -> None:
    """Add the addresses /axis/<axis>/reports/<name>; with ?save the file is downloaded."""

    @app.get("/axis/{axis}/reports/{name}")
    async def report(axis: str, name: str, save: str | None = None) -> Response:
        path = desks[axis].axis.store.directory / FOLDER / name if axis in desks and NAME.fullmatch(name) else None
        if path is None or not path.is_file():
            return PlainTextResponse("there is no such report", status_code=404)
        kind = "attachment" if save is not None else "inline"
        return FileResponse(path, headers=ALONE, filename=f"{axis}-{name}", content_disposition_type=kind)


def address(axis: str, name: str, *, save: bool = False) -> str:
    """Address of a report's file. save: for download."""
    return f"/axis/{axis}/reports/{name}" + ("?save" if save else "")
