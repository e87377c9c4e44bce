"""The axis file of a simulated machine."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

from sim_backends.bench import BenchParameters
from sim_backends.laser import LaserParameters

OVERRUN_MM = 1.0
"""Of [measurement] where an axis file does not state another: it has to fit between the outermost target and the end of the travel."""


def instrument_text(kind: str, port: str) -> str:
    """The [instrument] section for an instrument of a kind on a port; "umd": the laser. port: "" for the bench's own."""
    where = f"port = {json.dumps(port)}" if port else ""
    if kind == "umd":
        return f'kind = "umd"\n{where}\nplace_temps = {{ {LaserParameters().material_place} = 4 }}'
    if kind == "nd2xx":
        return f'kind = "nd2xx"\n{where}'
    pattern = "mitutoyo" if kind == "mitutoyo" else "number"
    return f'kind = "ascii"\n{where}\npattern = "{pattern}"\ndecimals = 4\nfault = "ERROR"'


def axis_text(
    parameters: BenchParameters,
    drive: dict[str, Any],
    instrument: str,
    counts_per_rev: int | None = None,
    name: str = "X",
) -> str:
    """An axis file for the machine, with targets over its whole travel. counts_per_rev: of a drive with a maker's own units.

    drive: the keys of [drive]; "homing" is a table of it."""
    limits, scaling = parameters.limits, parameters.scaling
    if counts_per_rev is not None:
        scaling = replace(scaling, encoder_counts_per_motor_rev=counts_per_rev)
    told = drive if drive.get("backend") == "bench" else drive | {"simulated": True}
    keys = "\n".join(f"{name} = {_toml(value)}" for name, value in told.items())
    low_mm, high_mm = limits.travel_min_mm + OVERRUN_MM, limits.travel_max_mm - OVERRUN_MM
    first, last = (round(low_mm + share * (high_mm - low_mm), 3) for share in (0.01, 0.99))
    return f"""\
# The machine of a running `hil sim`.

[axis]
name = {json.dumps(name)}
travel_min_mm = {limits.travel_min_mm!r}
travel_max_mm = {limits.travel_max_mm!r}
max_velocity_mm_s = {limits.max_velocity_mm_s!r}
max_acceleration_mm_s2 = {limits.max_acceleration_mm_s2!r}

[scaling]
encoder_counts_per_motor_rev = {scaling.encoder_counts_per_motor_rev}
feed_mm_per_shaft_rev = {scaling.feed_mm_per_shaft_rev!r}

[drive]
{keys}

[instrument]
{instrument}

[measurement]
first_mm = {first!r}
last_mm = {last!r}
sections = 11
runs = 2
velocity_mm_s = {min(100.0, limits.max_velocity_mm_s)!r}
"""


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_toml(item)}" for name, item in value.items()) + " }"
    return json.dumps(value)
