"""HTML elements of a report: escaped text, tables, figures with their data."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files

from hil.records.rows import Floats

_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f\ud800-\udfff\ufffe\uffff]")


def plain(value: object) -> str:
    """Any value as text. Control characters and code points that are no characters become U+FFFD."""
    return _UNPRINTABLE.sub("\ufffd", str(value))


POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


def page(title: str, parts: Iterable[str]) -> str:
    """A whole HTML page. It loads nothing from elsewhere, which its content security policy enforces.

    title: text, escaped here; parts: trusted markup, empty ones are left out
    """
    resources = files("hil.ui.report")
    style = (resources / "style.css").read_text(encoding="utf-8")
    script = (resources / "page.js").read_text(encoding="utf-8")
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f"<title>{text(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n"
        + "\n".join(part for part in parts if part)
        + f"\n<script>\n{script}</script>\n</body>\n</html>\n"
    )


def header(title: str, under: str = "") -> str:
    """The title of a page, and a line under it; both are text, escaped here."""
    return f"<header><h1>{text(title)}</h1>" + (f"<p>{text(under)}</p>" if under else "") + "</header>"


def tile(name: str, value: str, unit: str = "", note: str = "", *, css: str = "") -> str:
    """One number in large type. All arguments are text, escaped here."""
    below = f'<div class="from">{text(note)}</div>' if note else ""
    return (
        f'<div class="tile"><div class="name">{text(name)}</div>'
        f'<div class="value {css}">{text(value)} <small>{text(unit)}</small></div>{below}</div>'
    )


MAX_TABLE_ROWS = 2000
"""Most rows that a data table shows; the data embedded in the page are complete."""


def text(value: object) -> str:
    """A value as text, escaped for use within an element or a quoted attribute."""
    return escape(plain(value), quote=True)


def change(before: float | None, after: float | None) -> str:
    """A relative change as text, a dash where it is undefined."""
    return "–" if not before or after is None else f"{100 * (after - before) / abs(before):+.0f} %"


def number(value: float | None, decimals: int = 2) -> str:
    """A number with fixed decimals; a dash for None and for one that is not finite."""
    if value is None or not math.isfinite(value):
        return "–"
    return f"{value + 0.0:.{decimals}f}"


def significant(value: float | None, digits: int = 4) -> str:
    """A number with significant digits; a dash for None and for one that is not finite."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{digits}g}"


def table(head: Sequence[str], rows: Iterable[Sequence[str]], *, css: str = "", caption: str = "") -> str:
    """A table. All cells are text, escaped here; the first of each row is its heading."""
    title = f"<caption>{text(caption)}</caption>" if caption else ""
    columns = "".join(f'<th scope="col">{text(name)}</th>' for name in head)
    body = "\n".join(
        f'<tr><th scope="row">{text(row[0])}</th>' + "".join(f"<td>{text(cell)}</td>" for cell in row[1:]) + "</tr>"
        for row in rows
    )
    return (
        f'<div class="scroll"><table class="{text(css)}">{title}<thead><tr>{columns}</tr></thead>'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def definitions(facts: Mapping[str, str]) -> str:
    """A list of names with their values."""
    return (
        '<dl class="facts">'
        + "".join(f"<div><dt>{text(k)}</dt><dd>{text(v)}</dd></div>" for k, v in facts.items())
        + "</dl>"
    )


def paragraph_list(items: Iterable[str], css: str = "") -> str:
    lines = "".join(f"<li>{text(item)}</li>" for item in items)
    return f'<ul class="{text(css)}">{lines}</ul>' if lines else ""


def embedded(identifier: str, form: object) -> str:
    """Data as JSON in a script element, which programs can read from the page by its id."""
    dumped = json.dumps(form, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    safe = dumped.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
    return f'<script type="application/json" id="{text(identifier)}">{safe}</script>'


def columns_form(columns: Mapping[str, Floats]) -> dict[str, dict[str, list[float | None]]]:
    """Columns as plain JSON: {"columns": {name: [...]}}; numbers that are not finite become null."""
    return {
        "columns": {
            name: [
                None if not math.isfinite(v) else int(v) if v == int(v) and abs(v) < 1e15 else v
                for v in values.tolist()
            ]
            for name, values in columns.items()
        }
    }


def data_table(
    identifier: str,
    title: str,
    columns: Mapping[str, Floats],
    *,
    heads: Mapping[str, str] | None = None,
    unfolded: bool = False,
) -> str:
    """Columns of one length as embedded JSON, as a table that can be folded, and with a button that saves them as CSV.

    heads: headings in place of column names; unfolded: whether the table is shown at once
    """
    size = len(next(iter(columns.values())))
    shown = min(size, MAX_TABLE_ROWS)
    cells = {name: [cell(name, v) for v in values[:shown].tolist()] for name, values in columns.items()}
    rows = ([str(row + 1), *(cells[name][row] for name in columns)] for row in range(shown))
    cut = f"<p>The first {shown} of {size} rows; the saved file holds all.</p>" if shown < size else ""
    state = '"data" open' if unfolded else '"data folded"'
    return (
        embedded(identifier, columns_form(columns))
        + f"<details class={state}><summary>{text(title)} ({size} rows)</summary>"
        + f'<p><button type="button" hidden data-csv="{text(identifier)}">Save as CSV</button></p>{cut}'
        + table(["row", *((heads or {}).get(name, name) for name in columns)], rows, css="numbers small")
        + "</details>"
    )


def figure(svg: str, caption: str) -> str:
    """A drawing with its caption; `svg` is trusted markup."""
    return f"<figure>{svg}<figcaption>{text(caption)}</figcaption></figure>"


def cell(name: str, value: float) -> str:
    """A value of a column as text: two decimals for a name in _um, five in _mm; "" for one that is not finite."""
    if not math.isfinite(value):
        return ""
    if name.endswith("_um"):
        return f"{value:.2f}"
    if name.endswith("_mm"):
        return f"{value:.5f}"
    return str(int(value)) if value == int(value) and abs(value) < 1e9 else f"{value:.6g}"
