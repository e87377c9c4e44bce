"""The shell of every report: one HTML file that refers to nothing outside itself and says so in its own policy."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files

from hil.app.report import markup

POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


def page(title: str, parts: Iterable[str]) -> str:
    """The whole file; parts are trusted markup, empty ones are left out."""
    resources = files("hil.app.report")
    style = (resources / "style.css").read_text(encoding="utf-8")
    script = (resources / "page.js").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f"<title>{markup.text(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + f"\n<script>\n{script}</script>\n</body>\n</html>\n"
    )


def header(title: str, under: str = "") -> str:
    """The top of a report."""
    return f"<header><h1>{markup.text(title)}</h1>" + (f"<p>{markup.text(under)}</p>" if under else "") + "</header>"


def tile(name: str, value: str, unit: str = "", note: str = "", *, css: str = "") -> str:
    """One figure to be seen from afar; all text."""
    below = f'<div class="from">{markup.text(note)}</div>' if note else ""
    return (
        f'<div class="tile"><div class="name">{markup.text(name)}</div>'
        f'<div class="value {css}">{markup.text(value)} <small>{markup.text(unit)}</small></div>{below}</div>'
    )
