"""Contrast of the colours of screen and report, by WCAG 2.1: text 4.5 or more, signs and lines 3 or more, in dark and light."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest

from hil.ui.screen.plots import LIMIT, PALETTES

CSS = files("hil.app.panel").joinpath("static", "panel.css").read_text(encoding="utf-8")
TEXTS = (
    ("ink", "panel"),
    ("ink", "ground"),
    ("ink", "raised"),
    ("quiet", "panel"),
    ("quiet", "ground"),
    ("on-act", "act"),
    ("on-enabled", "enabled"),
    ("on-running", "running"),
    ("on-wait", "wait"),
    ("wait-text", "panel"),
    ("on-fault", "fault"),
    ("fault-text", "panel"),
    ("on-hatch", "hatch-a"),
    ("on-hatch", "hatch-b"),
    ("stale", "panel"),
    ("stale", "stale-hatch"),
    ("good", "panel"),
    ("bad", "panel"),
)
SIGNS = (("idle", "panel"), ("enabled", "panel"), ("running", "panel"), ("wait-edge", "panel"), ("faint", "panel"))


def tokens(dark: bool) -> dict[str, str]:
    """The colours by name; those of dark stand over those of light."""
    light = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", CSS.partition(".body--dark")[0]))
    own = CSS.partition(".body--dark {")[2].partition("}")[0]
    return light | dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", own)) if dark else light


def contrast(one: str, other: str) -> float:
    """Contrast of two colours, "#rrggbb" (WCAG 2.1, relative luminance)."""

    def luminance(colour: str) -> float:
        parts = [int(colour[at : at + 2], 16) / 255.0 for at in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_the_measure_itself() -> None:
    """The examples of WCAG's technique G18: black on white, and #777777 on white."""
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("dark", [True, False], ids=["dark", "light"])
def test_texts_signs_and_curves_are_legible(dark: bool) -> None:
    known = tokens(dark)
    poor = [f"{a} on {b}: {contrast(known[a], known[b]):.2f}" for a, b in TEXTS if contrast(known[a], known[b]) < 4.5]
    poor += [f"{a} on {b}: {contrast(known[a], known[b]):.2f}" for a, b in SIGNS if contrast(known[a], known[b]) < 3.0]
    curves = [*PALETTES[dark], LIMIT[dark]]
    poor += [
        f"curve {one}: {contrast(one, known['panel']):.2f}" for one in curves if contrast(one, known["panel"]) < 4.5
    ]
    poor += [f"STOP: {contrast('#ffffff', known['stop']):.2f}"] * (contrast("#ffffff", known["stop"]) < 4.5)
    assert not poor


def test_a_report_is_legible_in_light_dark_and_print() -> None:
    style = files("hil.ui.report").joinpath("style.css").read_text(encoding="utf-8")
    blocks = re.findall(r":root \{(.*?)\}", style, flags=re.DOTALL)
    assert len(blocks) == 3
    for block in blocks:
        known = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block))
        for ground in (known["page"], known["panel"]):
            for name in ("ink", "muted", "good", "warn", "plot-ink", "plot-muted"):
                assert contrast(known[name], ground) >= 4.5, name
            for name in ("plot-up", "plot-down", "plot-accent", "plot-band"):
                assert contrast(known[name], ground) >= 3.0, name
