"""The findings of a diagnosis as sentences in the page's language, from the effect, its form, and its figures with
units.

A sentence is stored under `explain.<effect>.<form>` in the texts; else that of the simpler form counts (without its fixed point
where that is not known, an even zone as any zone), or `explain.<effect>.any`. A user's own effect has none: its own English
sentence is shown.
"""

from __future__ import annotations

import re
from string import Formatter

from hil.diagnosis.page_data import ShownFinding
from hil.ui.screen.texts import Texts

UNITS = {
    "_um_s2_per_mm2": "µm·s²/mm²",
    "_um_per_percent": "µm/%",
    "_um_per_kg": "µm/kg",
    "_um_per_m2": "µm/m²",
    "_um_per_m": "µm/m",
    "_um_per_k": "µm/K",
    "_ppm_per_k": "ppm/K",
    "_mm_s": "mm/s",
    "_urad": "µrad",
    "_rows": "",
    "_ppm": "ppm",
    "_mm": "mm",
    "_ms": "ms",
    "_um": "µm",
    "_s": "s",
    "phase": "rad",
}
"""Unit by the end of a parameter's name, longer ends first."""


BOUND = re.compile(r"(least|most)_(.+)")
"""A parameter of which the rows determine only a bound."""


def sentence(t: Texts, finding: ShownFinding) -> str:
    """The finding in one sentence, with figures and units."""
    form = re.sub(r"\W+", "_", finding.form)
    known = {name for name, _, _ in finding.parameters}
    ends = form, form.removesuffix("_about_a_fixed_point"), form.removeprefix("flat_"), "any"
    keys = [f"explain.{finding.effect}.{end}" for end in ends]
    if known == {"rms_um"}:
        keys = ["explain.summed.any"]
    elif all(BOUND.match(name) for name in known) and any(key in t for key in keys):
        keys = ["explain.undetermined.any"]
    inputs = [t.said(name) for name in finding.inputs]
    places: dict[str, str] = {"input": inputs[0] if inputs else "–", "inputs": " · ".join(inputs)}
    places["rms"] = t.estimate(finding.rms_um, None, "µm")
    bounds: dict[str, list[str]] = {}
    for name, value, std in finding.parameters:
        stem, unit = _split(t, name)
        if match := BOUND.fullmatch(stem):
            bounds.setdefault(match[2], []).append(t(f"bound.{match[1]}", value=t.estimate(value, None, unit)))
        places[stem] = t.estimate(value, std, unit, finding.intervals.get(name))
    places |= {stem: ", ".join(parts) for stem, parts in bounds.items()}
    if "amount_at_shortest_travel" in places:
        seen, travel = places["amount_at_shortest_travel"], places["shortest_travel"]
        places["amount"] = t("bound.at_travel", amount=seen, travel=travel)
    for key in keys if finding.form else ():
        if key in t and {place for _, place, _, _ in Formatter().parse(t(key)) if place} <= set(places):
            return t(key, **places)
    return finding.explanation


def parameter(t: Texts, name: str) -> str:
    """A parameter as a heading, such as "Period, mm"; one of a user's own effect by its own name."""
    stem, unit = _split(t, name)
    if (bound := BOUND.fullmatch(stem)) and f"parameter.{bound[2]}" in t:
        said = t(f"parameter.{bound[1]}", of=t(f"parameter.{bound[2]}"))
        return f"{said}, {unit}" if unit else said
    match = re.fullmatch(r"(.+)_(\d+)", stem)
    key, number = (f"parameter.{match[1]}", match[2]) if match else (f"parameter.{stem}", "")
    if key not in t:
        return name
    said = t(key, number=number) if number else t(key)
    return f"{said}, {unit}" if unit else said


def _split(t: Texts, name: str) -> tuple[str, str]:
    """The name of a parameter without its unit, and the unit."""
    ending = next((one for one in UNITS if name.endswith(one)), "")
    unit = t("unit.rows") if ending == "_rows" else UNITS.get(ending, "")
    return (name.removesuffix(ending) or name), unit
