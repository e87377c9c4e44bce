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
            unseen: !one.checkVisibility({ visibilityProperty: true, opacityProperty: true }),
        };
    }
    return [found, document.documentElement.scrollWidth - document.documentElement.clientWidth];
"""


DEFECTS = """
    const named = (one) => one.closest('[data-name]')?.dataset.name ?? one.className;
    const may_be_cut = '.hil-cut, .hil-job-name, .hil-clamp, [data-name="header.state"]';
    const shown = (one) => one.checkVisibility() && one.getBoundingClientRect().width > 0;
    const leaf = (one) => [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    const texts = [...document.querySelectorAll('.hil-bar *, .hil-rail *, .hil-card *, .hil-buttons *, .hil-alarm *, .hil-gone *')]
        .filter((one) => shown(one) && leaf(one) && !one.closest('.q-field, canvas, svg, table, .hil-plot, .hil-mark'));
    const found = [];
    const boxes = texts.map((one) => {
        const range = document.createRange();
        range.selectNodeContents(one);
        const all = range.getBoundingClientRect(), own = one.getBoundingClientRect();
        if (getComputedStyle(one).overflow === 'visible') return all;
        const [left, top, right, bottom] = [Math.max(all.left, own.left), Math.max(all.top, own.top),
            Math.min(all.right, own.right), Math.min(all.bottom, own.bottom)];
        return { left, top, right, bottom };
    });
    const fixed = (one) => Boolean(one.closest('.hil-bar, .hil-rail'));
    for (let i = 0; i < texts.length; i += 1) {
        const box = boxes[i], one = texts[i];
        const larger = one.scrollWidth > one.clientWidth + 1 || one.scrollHeight > one.clientHeight + 3;
        const cut = larger && getComputedStyle(one).overflow !== 'visible';
        if (cut && !one.matches(may_be_cut)) found.push(`${named(one)} is cut: ${one.textContent}`);
        const card = one.closest('.hil-card, .q-btn, .hil-bar, .hil-rail a');
        const edge = card?.getBoundingClientRect();
        if (edge && (box.right > edge.right + 1 || box.left < edge.left - 1 || box.bottom > edge.bottom + 2))
            found.push(`${named(one)} leaves its card: ${one.textContent}`);
        for (let j = i + 1; j < texts.length; j += 1) {
            const other = boxes[j];
            if (one.contains(texts[j]) || texts[j].contains(one) || fixed(one) !== fixed(texts[j])) continue;
            const wide = Math.min(box.right, other.right) - Math.max(box.left, other.left);
            const high = Math.min(box.bottom, other.bottom) - Math.max(box.top, other.top);
            if (wide > 2 && high > 4)
                found.push(`${named(one)} and ${named(texts[j])} overlap: ${one.textContent} | ${texts[j].textContent}`);
        }
    }
    for (const one of document.querySelectorAll('.q-field__label, .q-field__native .ellipsis'))
        if (shown(one) && one.scrollWidth > one.clientWidth + 1) found.push(`${named(one)} is cut: ${one.textContent}`);
    const wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
    if (wide > 0) found.push(`the page is ${wide} px wider than the window`);
    return found;
"""
"""Script: texts that overlap, are cut, or leave their card, and a page that is wider than its window."""
OUT_OF_SIGHT = """
    return arguments[0].filter((name) => {
        const box = document.querySelector(`[data-name='${name}']`)?.getBoundingClientRect();
        return !box || !box.width || box.bottom > innerHeight + 1 || box.top < 0 || box.right > innerWidth + 1;
    });
"""
"""Script: which of the named elements are not wholly in the window."""
PALE = """
    const rgba = (text) => {
        const n = (text.match(/[\\d.]+/g) ?? []).map(Number);
        return n.length < 3 ? [0, 0, 0, 0] : [n[0], n[1], n[2], n[3] ?? 1];
    };
    const over = (top, under) => [0, 1, 2].map((i) => top[i] * top[3] + under[i] * (1 - top[3])).concat(1);
    const light = (c) => c.slice(0, 3).map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
        .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
    const contrast = (a, b) => {
        const [low, high] = [light(a), light(b)].sort((x, y) => x - y);
        return (high + 0.05) / (low + 0.05);
    };
    const grounds = (one) => {
        const layers = [];
        for (let at = one; at; at = at.parentElement) {
            const style = getComputedStyle(at), drawn = style.backgroundImage.match(/rgba?\\([^)]*\\)/g);
            if (drawn && style.backgroundImage.startsWith('repeating')) { layers.push(drawn.map(rgba)); break; }
            const colour = rgba(style.backgroundColor);
            if (colour[3] > 0) layers.push([colour]);
            if (colour[3] === 1) break;
        }
        const onto = (under, layer) => under.flatMap((u) => layer.map((top) => over(top, u)));
        return layers.reverse().reduce(onto, [[255, 255, 255, 1]]);
    };
    const faint = (one) => {
        let share = 1;
        for (let at = one; at; at = at.parentElement) share *= Number(getComputedStyle(at).opacity);
        return share;
    };
    const seen = (one) => one.checkVisibility({ visibilityProperty: true }) && one.getBoundingClientRect().width > 0;
    const found = [];
    for (const one of document.querySelectorAll('body *')) {
        const own = [...one.childNodes].filter((node) => node.nodeType === 3);
        const text = own.map((node) => node.textContent.trim()).join('');
        if (!text || !seen(one) || one.closest('svg, script, style')) continue;
        const style = getComputedStyle(one), ink = rgba(style.color), share = ink[3] * faint(one);
        if (parseFloat(style.fontSize) === 0) continue;
        const drawn = [...ink.slice(0, 3), share], name = one.closest('[data-name]')?.dataset.name ?? one.className;
        const worst = Math.min(...grounds(one).map((ground) => contrast(over(drawn, ground), ground)));
        if (worst < 4.5) found.push(`${name}: ${worst.toFixed(2)}: ${text.slice(0, 40)}`);
    }
    return found;
"""
"""Script: texts whose contrast with what is behind them is below 4.5 (WCAG 2.1, relative luminance)."""


def at_rest(person: Person) -> None:
    """Wait until the page is drawn: its fonts are there, nothing fades in, and the server is heard."""
    script = """
        const still = document.getAnimations().every((one) => one.effect.getComputedTiming().iterations === Infinity);
        const heard = document.querySelector("[data-name='no-data']")?.hidden !== false;
        return document.fonts.status === 'loaded' && still && heard && window.did_handshake;
    """
    person.waits(lambda: person.driver.execute_script(script), "the page is drawn")


def settled(person: Person, script: str, *arguments: object) -> list[Any]:
    """What a script finds wrong once the page is drawn. On a busy machine the page may lose its server for a moment while it is looked
    at, or draw what has just come: what is wrong at one look only is looked at again."""
    found: list[list[Any]] = []

    def looks() -> bool:
        at_rest(person)
        found.append(person.driver.execute_script(script, *arguments))
        return not found[-1] or found[-SAME:].count(found[-1]) == SAME

    person.waits(looks, "it looks the same several times")
    return found[-1]


SAME = 5
"""Number of looks in a row, 50 ms apart or more, that have to find the same before it counts as a defect."""


def complaints(person: Person, wanted: Iterable[str]) -> list[str]:
    """Defects of these elements on the page as it is drawn, which `SAME` pictures in a row show; none as soon as one shows none."""
    found: list[list[str]] = []

    def looks() -> bool:
        at_rest(person)
        found.append(_complaints(person, tuple(wanted)))
        return not found[-1] or found[-SAME:].count(found[-1]) == SAME

    wanted = tuple(wanted)
    person.waits(looks, "it looks the same several times")
    return found[-1]


def _complaints(person: Person, wanted: Iterable[str]) -> list[str]:
    """Defects in one picture; the window is made as high as the page first."""
    picture, (places, too_wide) = _picture(person)
    found = [f"the page is {too_wide} pixels wider than the window"] if too_wide > 0 else []
    for name in wanted:
        place: dict[str, Any] | None = places.get(name)
        if place is None:
            found.append(f"{name} is not there")
        elif place["hidden"]:
            found.append(f"{name} takes no place")
        else:
            found += [f"{name} is {what}" for what in ("covered", "small", "unseen") if place[what]]
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


def foreign_fonts(person: Person) -> dict[str, set[str]]:
    """The fonts of the machine that texts of the page are drawn in, with these texts. What is drawn in a font that the page brings
    itself looks the same on every machine."""
    script = """
        const leaf = (one) => [...one.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
        const seen = (one) => one.checkVisibility() && one.getBoundingClientRect().width > 1;
        const all = [...document.querySelectorAll('[class*="hil-"] *, [data-name], [data-name] *')];
        const texts = all.filter((one) => seen(one) && leaf(one));
        document.querySelectorAll('[data-leaf]').forEach((one) => { delete one.dataset.leaf; });
        texts.forEach((one) => { one.dataset.leaf = ''; });
        return texts.map((one) => one.textContent.trim());
    """
    texts = person.driver.execute_script(script)
    for domain in ("DOM", "CSS"):
        person.driver.execute_cdp_cmd(f"{domain}.enable", {})
    root = person.driver.execute_cdp_cmd("DOM.getDocument", {"depth": 0})["root"]["nodeId"]
    found: dict[str, set[str]] = {}
    where = {"nodeId": root, "selector": "[data-leaf]"}
    nodes = person.driver.execute_cdp_cmd("DOM.querySelectorAll", where)["nodeIds"]
    if len(nodes) != len(texts):  # some was drawn anew meanwhile
        return foreign_fonts(person)
    for node, text in zip(nodes, texts, strict=True):
        drawn = person.driver.execute_cdp_cmd("CSS.getPlatformFontsForNode", {"nodeId": node})["fonts"]
        for one in drawn:
            if not one["isCustomFont"]:
                found.setdefault(one["familyName"], set()).add(text)
    for domain in ("CSS", "DOM"):
        person.driver.execute_cdp_cmd(f"{domain}.disable", {})
    return found
