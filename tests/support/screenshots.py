"""Checks that a screenshot of a page shows its named elements: each is looked for in the picture at its reported position."""

from __future__ import annotations

from collections.abc import Iterable
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image
from support.panel import Person

INK, CONTRAST = 6, 30.0
"""Number of pixels of an element's area that have to differ from its background, and by how much (of 255) in a colour."""
_PLACES = """
    const found = {};
    for (const one of document.querySelectorAll('[data-name]')) {
        const box = one.getBoundingClientRect();
        const x = box.x + box.width / 2, y = box.y + box.height / 2;
        const there = document.elementFromPoint(x, y);
        const card = one.closest('.hil-card');
        found[one.dataset.name] = {
            box: [box.x, box.y, box.right, box.bottom],
            covered: !(there && (one.contains(there) || there.contains(one))),
            spills: card !== null && card.scrollWidth > card.clientWidth + 1,
            small: one.matches('button, .q-btn, a') && (box.height < 47.5 || box.width < 47.5),
            hidden: box.width === 0 || box.height === 0,
        };
    }
    return [found, document.documentElement.scrollWidth - document.documentElement.clientWidth];
"""


def complaints(person: Person, wanted: Iterable[str]) -> list[str]:
    """Defects of these elements on the page as it is drawn; the window is made as high as the page first."""
    picture, (places, too_wide) = _picture(person)
    found = [f"the page is {too_wide} pixels wider than the window"] if too_wide > 0 else []
    for name in wanted:
        place: dict[str, Any] | None = places.get(name)
        if place is None:
            found.append(f"{name} is not there")
        elif place["hidden"]:
            found.append(f"{name} takes no place")
        else:
            found += [f"{name} is {what}" for what in ("covered", "small") if place[what]]
            found += [f"the card of {name} is too narrow"] if place["spills"] else []
            found += [] if _is_drawn(picture, place["box"]) else [f"{name} is not to be seen in the picture"]
    return found


def _picture(person: Person) -> tuple[np.ndarray, Any]:
    """(rows, columns, 3) of the whole page, and the positions of its elements; repeated while the page still grows."""
    found: list[tuple[np.ndarray, Any]] = []

    def whole() -> bool:
        height = _size(person, "Height")
        device = {"width": _size(person, "Width"), "height": height, "deviceScaleFactor": 1, "mobile": False}
        person.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", device)
        try:
            places = person.driver.execute_script(_PLACES)
            shot = Image.open(BytesIO(person.driver.get_screenshot_as_png())).convert("RGB")
            is_whole = shot.height == height and places == person.driver.execute_script(_PLACES)
        finally:
            person.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        found.append((np.asarray(shot, dtype=np.float64), places))
        return is_whole and _size(person, "Height") <= height

    person.waits(whole, "the page has its size")
    return found[-1]


def _size(person: Person, which: str) -> int:
    inside = "scroll" if which == "Height" else "client"
    return int(person.driver.execute_script(f"return document.documentElement.{inside}{which}"))


def _is_drawn(picture: np.ndarray, box: list[float]) -> bool:
    """Whether an area of the picture holds anything but background."""
    left, top, right, bottom = (round(edge) for edge in box)
    inside = picture[max(0, top) : bottom, max(0, left) : right].reshape(-1, 3)
    if not len(inside):
        return False
    ground = np.median(inside, axis=0)
    return int(np.sum(np.abs(inside - ground).max(axis=1) > CONTRAST)) >= INK
