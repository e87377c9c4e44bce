"""The plot of a run-out: the ball's centre about the spindle axis, magnified."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.probe.page_data import BallPositions
from hil.ui.screen.drawings import Options, angle_axis
from hil.ui.screen.plots import FONT, PALETTES, inks, number_format, one_line_legend
from hil.ui.screen.view import View

REACH = 1.25
"""Radius of the plot, as a multiple of the outermost position."""


def around_the_spindle(view: View, shown: BallPositions, names: Mapping[str, str]) -> Options:
    """Chart options of the positions seen along the spindle axis, in µm. names: of "run_out", "circle" and
    "contacts".
    """
    ink, grid = inks(view)
    size_um, bearing_deg = shown.run_out
    places = [[_short(far), _short(at)] for far, at in shown.at.values()]
    circle = {
        "name": names["circle"],
        "type": "line",
        "showSymbol": False,
        "silent": True,
        "data": [[_short(size_um), angle] for angle in range(0, 361, 3)],
        "lineStyle": {"color": ink, "width": 2, "type": "dashed"},
        "itemStyle": {"color": ink},
    }
    arrow = {
        "name": names["run_out"],
        "type": "line",
        "data": [[0, _short(bearing_deg)], [_short(size_um), _short(bearing_deg)]],
        "symbol": ["none", "circle"],
        "showSymbol": False,
        "lineStyle": {"color": PALETTES[view.browser.dark][1], "width": 5},
        "itemStyle": {"color": PALETTES[view.browser.dark][1]},
    }
    contacts = {
        "name": names["contacts"],
        "type": "scatter",
        "symbolSize": 16,
        "z": 3,
        "data": [
            {
                "value": place,
                "label": {"formatter": f"{angle}°", "position": "left" if 90 < place[1] < 270 else "right"},
            }
            for angle, place in zip(shown.at, places, strict=True)
        ],
        "label": {"show": True, "color": ink, "fontSize": 16},
        "itemStyle": {"color": PALETTES[view.browser.dark][5]},
    }
    series: list[dict[str, Any]] = [{**one, "coordinateSystem": "polar"} for one in (circle, arrow, contacts)]
    label = f"value => ({number_format(view)})(Number(value.toPrecision(3)))"
    return {
        "animation": False,
        "textStyle": {"fontFamily": FONT},
        "legend": one_line_legend(ink),
        "polar": {"center": ["50%", "54%"], "radius": "76%"},
        "angleAxis": angle_axis(ink, grid),
        "radiusAxis": {
            "type": "value",
            "min": 0,
            "max": _short(REACH * max(size_um, 0.5, *(far for far, _ in shown.at.values()))),
            "splitNumber": 4,
            "axisLabel": {"color": ink, "fontSize": 13, "margin": 4, "showMaxLabel": False, ":formatter": label},
            "axisTick": {"show": False},
            "axisLine": {"show": False},
            "splitLine": {"lineStyle": {"color": grid}},
        },
        "series": series,
    }


def _short(value: float) -> float:
    return float(f"{value:.5g}")
