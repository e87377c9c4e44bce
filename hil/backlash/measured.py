"""The result of `hil backlash`: figures, sentences, table, plain values and report, for every face."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from hil.axis.backlash import BacklashConfig
from hil.axis.identity import measured_now
from hil.backlash.neutral_settings import BacklashSettings
from hil.backlash.result import NAMES, TorqueBacklash, reversal_json
from hil.backlash.settings import NoSetting
from hil.desk.result import Result
from hil.desk.rows import Rows
from hil.ui.report.markup import definitions, header, number, page, table, text

HEAD = ("run", "four-sample, µm", "fitted, µm", "± U95, µm", "break-away, µm", "its torque, %", "sliding, %")


@dataclass(frozen=True, repr=False)
class BacklashResult(Result):
    """Lost motion by torque. how: [backlash] as used; settings: where the drive keeps the amount; kept: file of the readings."""

    how: BacklashConfig
    settings: BacklashSettings
    raw: TorqueBacklash
    kept: Path

    @property
    def lost_motion_um(self) -> float | None:
        """Mean over the directions measured, None if the detection limit was exceeded."""
        return self.raw.lost_motion_um

    @cached_property
    def u95_um(self) -> float | None:
        """Its uncertainty at 95 %, None without a fit."""
        return None if self.raw.fitted is None else self.raw.fitted.u95_um

    @property
    def written(self) -> bool:
        """Whether the mean was written."""
        return self.raw.written is not None

    @property
    def good(self) -> bool:
        """Whether a mean was found."""
        return self.lost_motion_um is not None

    @property
    def sentence(self) -> str:
        """The mean with its uncertainty."""
        mean, spread = self.lost_motion_um, self.u95_um
        if mean is None:
            return f"backlash of {self.axis.name}: detection limit exceeded"
        return f"backlash of {self.axis.name}: {mean:.1f}" + ("" if spread is None else f" ± {spread:.1f}") + " µm"

    @property
    def verdict(self) -> str:
        """Why there is no mean, "" if there is one."""
        exceeded = self.raw.exceeded
        if exceeded is None:
            return ""
        reach_um, seen, hint = float(exceeded.trace.travel_um[-1]), exceeded.published_um, ""
        if seen is not None:
            hint = f"; the four-sample rule has a peak at {seen:.1f} µm, finer steps may show a wind-up there"
        return (
            f"detection limit exceeded: {NAMES[exceeded.trace.direction]} shows no break-away within {reach_um:.0f} µm"
            f" ({len(exceeded.trace.position_load_mm) - 1} steps); everything is as it was, nothing was written{hint}"
        )

    @property
    def rows(self) -> Rows:
        """The torque at each step of every reversal: run, direction, motor_mm, torque_percent (mean of its readings)."""
        import numpy as np  # noqa: PLC0415

        traces = [(one.run, one.trace) for one in self.raw.reversals]
        sizes = [len(trace.position_load_mm) for _, trace in traces]
        columns = {
            "run": np.repeat([float(run) for run, _ in traces], sizes),
            "direction": np.repeat([float(trace.direction) for _, trace in traces], sizes),
            "motor_mm": np.concatenate([trace.position_load_mm for _, trace in traces]),
            "torque_percent": np.concatenate([trace.torque_percent.mean(axis=1) for _, trace in traces]),
        }
        return Rows(columns)

    def table(self) -> list[list[str]]:
        """One line for each reversal: its run, both estimates, U95, break-away, its torque, and that of sliding."""
        decimals = {"four_sample_um": 1, "fitted_um": 2, "fitted_u95_um": 2, "break_away_um": 1}
        decimals |= {"break_away_percent": 2, "sliding_percent": 2}
        found = [reversal_json(one) for one in self.raw.reversals]
        return [
            [f"{one['run']}, {one['reversal']}", *(number(one[name], places) for name, places in decimals.items())]
            for one in found
        ]

    def parameters(self) -> dict[str, str]:
        """The drive's parameters before and now, as label -> text."""
        raw, settings = self.raw, self.settings
        if isinstance(settings.amount, NoSetting):
            lines = {"drive's own compensation": "none"}
        else:
            lines = {f"{name} held before": self._held(name, value) for name, value in raw.found.values.items()}
        if raw.written is None:
            lines["now"] = "as before, nothing was written"
        elif isinstance(settings.amount, NoSetting):
            lines["now"] = f"{raw.written:g} µm in the sealed tables, beside their pitch; not yet proven (hil verify)"
        else:
            held = self._held(settings.amount.name, raw.written)
            lines[f"{settings.amount.name} holds now"] = f"{held}, written and read back"
        if settings.scale != 1.0 and raw.lost_motion_um is not None:
            scaled_um = settings.scale * raw.lost_motion_um
            product = f"{raw.lost_motion_um:.2f} × {settings.scale:g} ([backlash] scale)"
            lines["amount to write"] = f"{scaled_um:.2f} µm: {product}"
        if raw.found.from_note:
            lines["note"] = "an earlier measurement had not put these back; this one has"
        return lines

    def _held(self, name: str, value: float) -> str:
        """What a setting of the drive holds; the amount also in µm, where its unit is another."""
        one_um = self.settings.amount_um
        if name != self.settings.amount.name:
            return f"{value:g}"
        return f"{value * one_um:g} µm" + ("" if one_um == 1.0 else f" ({value:g} in the drive's unit)")

    def identity(self) -> dict[str, str]:
        """What was measured, and how, as label -> text."""
        how = self.how
        return {
            **measured_now(self.axis),
            "Reversals": ", ".join(f"{NAMES[each]} at {how.turning_mm(each):g} mm" for each in how.directions),
            "Feed": how.feed if how.feed == "steps" else f"creep at {how.creep_um_s:g} µm/s, averaged over steps",
            "Steps": f"{how.step_um:g} µm at {how.velocity_mm_s:g} mm/s, {how.readings} readings after {how.settle_s:g} s at rest",
        }

    def form(self) -> dict[str, Any]:
        """As `hil backlash --json`; lengths in µm."""
        raw, found = self.raw, self.raw.fitted
        return {
            "axis": self.axis.name,
            "good": self.good,
            "detection_limit_exceeded": raw.exceeded is not None,
            "method": raw.method,
            "feed": self.how.feed,
            "lost_motion_um": self.lost_motion_um,
            "scale": self.how.scale,
            "fitted": None if found is None else {"mean_um": found.mean_um, "u95_um": found.u95_um},
            "four_sample": {"mean_um": raw.by_rule_um},
            "by_direction_um": {NAMES[each]: value for each, value in raw.by_direction_um.items()},
            "reversals": [reversal_json(one) for one in raw.reversals],
            "parameters": {
                "before": raw.found.values,
                "amount": self.settings.amount.name,
                "amount_um": self.settings.amount_um,
                "written": raw.written,
            },
        }

    def _page(self) -> str:
        from hil.backlash.report import FOOTER, drawn_run, tiles  # noqa: PLC0415  (plots are slow to import)

        title, identity, reversals = (
            f"Lost motion of axis {self.axis.name} by torque",
            self.identity(),
            self.raw.reversals,
        )
        parts = [
            header(title, identity["Measured"]),
            tiles(self.raw),
            f'<p class="callout">{text(self.verdict)}</p>' if self.verdict else "",
            "<h2>Identity</h2>" + definitions(identity),
            *(drawn_run(reversals, run) for run in sorted({one.run for one in reversals})),
            "<h2>Every reversal</h2>" + table(HEAD, self.table(), css="numbers"),
            "<h2>Parameters of the drive</h2>" + definitions(self.parameters()),
            FOOTER,
        ]
        return page(title, parts)
