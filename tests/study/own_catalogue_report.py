"""The report of the study: each figure beside its required bounds, and the answers for every effect."""

from __future__ import annotations

import html
import math
from collections import Counter
from collections.abc import Mapping, Sequence

WANTED: dict[str, tuple[float, float]] = {
    "strong: right first": (0.99, 1.0),
    "weak: right first": (0.90, 1.0),
    "true parameter inside its 95 % interval": (0.90, 0.99),
    "clean, normal: finding or unexplained": (0.0, 0.01),
    "clean, student: finding or unexplained": (0.0, 0.03),
    "clean, correlated: finding or unexplained": (0.0, 0.03),
    "clean, walk: finding or unexplained": (0.0, 0.03),
    "clean, offsets: finding or unexplained": (0.0, 0.03),
    "outside: unexplained": (0.90, 1.0),
    "outside: confident name": (0.0, 0.03),
    "pair: both": (0.85, 1.0),
    "appeared: right first": (0.99, 1.0),
    "fresh RMS over noise: median": (0.0, 1.1),
    "fresh RMS over noise: 90 %": (0.0, 1.3),
}
"""Bounds of each figure."""

Row = tuple[str, tuple[str, ...], str, tuple[str, ...], bool]
"""kind, true effects, noise, names found, unexplained"""
Table = tuple[str, tuple[str, ...], list[tuple[str, ...]]]


def report(figures: Mapping[str, float], rows: Sequence[Row], how: str, as_html: bool) -> str:
    """The text of the report, Markdown or a single HTML page."""
    title = "Diagnosis on machines drawn at random"
    counts = Counter(row[0] for row in rows)
    about = f"python tests/study/own_catalogue.py {how}: " + ", ".join(f"{n} {kind}" for kind, n in counts.items())
    tables = [_figures(figures), _effects(rows)]
    return _page(title, about, tables) if as_html else _markdown(title, about, tables)


def _figures(figures: Mapping[str, float]) -> Table:
    out: list[tuple[str, ...]] = []
    for name, value in figures.items():
        low, high = WANTED.get(name, (-math.inf, math.inf))
        wanted = (
            ""
            if name not in WANTED
            else f"≥ {low:g}"
            if high == 1.0
            else f"≤ {high:g}"
            if low == 0.0
            else f"{low:g} … {high:g}"
        )
        verdict = "" if name not in WANTED else "reached" if low <= value <= high else "missed"
        out.append((name, f"{value:.3f}", wanted, verdict))
    return "Figures", ("figure", "value", "wanted", ""), out


def _effects(rows: Sequence[Row]) -> Table:
    """By kind and true cause, how often each answer was given."""
    answers: dict[tuple[str, str], Counter[str]] = {}
    for kind, effects, noise, names, unexplained in rows:
        if kind == "pair":
            continue
        answer = " + ".join(names) or ("" if unexplained else "nothing")
        answer = f"{answer} + unexplained".removeprefix(" + ") if unexplained else answer
        answers.setdefault((kind, " + ".join(effects) or noise), Counter())[answer] += 1
    out = [
        (kind, cause, str(sum(found.values())), ", ".join(f"{answer} {n}" for answer, n in found.most_common()))
        for (kind, cause), found in sorted(answers.items())
    ]
    return "Answers", ("kind", "true cause", "machines", "answers"), out


def _markdown(title: str, about: str, tables: Sequence[Table]) -> str:
    lines = [f"# {title}", "", f"`{about}`"]
    for name, head, rows in tables:
        lines += ["", f"## {name}", "", f"| {' | '.join(head)} |", "|" + " --- |" * len(head)]
        lines += [f"| {' | '.join(row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def _page(title: str, about: str, tables: Sequence[Table]) -> str:
    def cells(values: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(value)}</{tag}>" for value in values) + "</tr>\n"

    body = "".join(
        f"<h2>{name}</h2>\n<table>\n{cells(head, 'th')}{''.join(cells(row, 'td') for row in rows)}</table>\n"
        for name, head, rows in tables
    )
    style = "body{font:15px sans-serif;margin:2em}table{border-collapse:collapse}td,th{border:1px solid #999;padding:.2em .6em}"
    head = f'<meta charset="utf-8"><title>{title}</title><style>{style}</style>'
    return f"<!doctype html>\n<html lang=en>{head}\n<h1>{title}</h1>\n<p><code>{html.escape(about)}</code></p>\n{body}</html>\n"
