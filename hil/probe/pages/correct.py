"""M91 to M93, the centring of a bore and other measurements with the run-out in force, a part of the probe's page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from nicegui import ui

from hil.desk.desk import Desk
from hil.desk.job import Job
from hil.probe import job as probe
from hil.probe.machine_file import ProbeMachineConfig
from hil.probe.page_data import ProbeRecord, last_at, lent, result_at, store_at
from hil.probe.procedure import BoreCentre, Correction, FeatureMeasurement
from hil.probe.runout import CorrectionCode
from hil.probe.store import RunOutStore
from hil.records.rows import UM_PER_MM
from hil.ui.screen.pieces import FolderContents, Latest, ScreenTable
from hil.ui.screen.view import Refresh, View

Kept = FolderContents[ProbeRecord]


def draw_corrections(at: ProbePage, kept: Kept, mode: ui.select) -> Refresh:
    """Draws the cards; returns their refresh. mode: the selection of how contacts are found"""
    with ui.element("div").classes("hil-grid"):
        parts = [_draw_correction(at, kept), _draw_bore(at, kept, mode)]
    if at.config.features:
        parts.append(_draw_others(at, kept, mode))

    def refresh() -> None:
        for part in parts:
            part()

    return refresh


def _draw_code(at: ProbePage, name: str) -> ui.select:
    """Selection of the axes to correct; by default the last code that the machine can do."""
    codes, t = at.config.codes, at.view.t
    choices = {code.value: f"{codes.name(code)}: {t(f'probe.codes.{code.value}')}" for code in probe.codes(at.config)}
    return at.view.named(ui.select(choices, label=at.view.t("probe.code"), value=list(choices)[-1]), name)


def _draw_correction(at: ProbePage, kept: Kept) -> Refresh:
    """Moves the axes by the run-out in force."""
    view = at.view
    with view.card("probe.correction"):
        with ui.row().classes("items-end hil-fields"):
            code = _draw_code(at, "probe.code")

            async def start() -> None:
                store, known = at.store, None if kept.value is None else kept.value.in_force
                if store is not None and known is not None:
                    await at.ask_and_run(probe.correction_job(at.config, store, known, CorrectionCode(code.value)))

            button = view.button("probe.correct", start)
        fill = _draw_driven(at, "probe")

    def refresh() -> None:
        button.allow(at.why_not() or _no_run_out(at, kept))
        fill(result_at(view.desks, probe.CORRECT, Correction))

    return refresh


def _no_run_out(at: ProbePage, kept: Kept) -> str:
    """Why nothing can be corrected: no run-out is in force, or its store is not opened; "" where one is."""
    there = kept.value is not None and kept.value.in_force is not None
    return "" if there else at.view.t("why.no_run_out")


def _draw_driven(at: ProbePage, name: str) -> Callable[[Correction | None], None]:
    """The distances moved, and the remaining counter; returns the function that fills them."""
    view, t = at.view, at.view.t
    driven = view.value("probe.driven", "µm", small=True, name=f"{name}.driven")
    counter = view.value("probe.counter", "µm", small=True, name=f"{name}.counter")

    def pair(values_mm: tuple[float, float]) -> str:
        x, y = (t.number(UM_PER_MM * value, 2, sign=True) for value in values_mm)
        return t("probe.pair", x=x, y=y)

    def fill(done: Correction | None) -> None:
        driven.set_text("–" if done is None else pair(done.driven_mm))
        counter.set_text("–" if done is None else pair(done.counter_mm))

    return fill


def _draw_bore(at: ProbePage, kept: Kept, mode: ui.select) -> Refresh:
    """Touches a bore on both sides and moves to its centre."""
    view, t = at.view, at.view.t
    with view.card("probe.bore"):
        if at.config.bore is None:
            view.named(ui.label(t("probe.no_bore")).classes("hil-note"), "probe.no_bore")
            return lambda: None
        with ui.row().classes("items-end hil-fields"):
            code = _draw_code(at, "probe.bore.code")

            async def start() -> None:
                store, known = at.store, None if kept.value is None else kept.value.in_force
                if store is not None and known is not None:
                    chosen = CorrectionCode(code.value)
                    await at.ask_and_run(probe.centring_job(at.config, store, known, chosen, str(mode.value)))

            button = view.button("probe.centre", start)
        centre = view.value("probe.bore_centre", "mm", small=True, name="probe.bore.centre")
        middle = view.value("probe.middle", "mm", small=True, name="probe.bore.middle")
        diameter = view.value("probe.diameter", "mm", small=True, name="probe.bore.diameter")
        fill = _draw_driven(at, "probe.bore")

    def pair(values_mm: tuple[float, float]) -> str:
        x, y = (t.number(value, 4) for value in values_mm)
        return t("probe.pair", x=x, y=y)

    def refresh() -> None:
        button.allow(at.why_not() or _no_run_out(at, kept))
        found = result_at(view.desks, probe.CENTRE, BoreCentre)
        centre.set_text("–" if found is None else pair(found.centring.centre_mm))
        middle.set_text("–" if found is None else pair(found.centring.middle_mm))
        diameter.set_text("–" if found is None else t.number(found.centring.diameter_mm, 4))
        fill(None if found is None else found.correction)

    return refresh


def _draw_others(at: ProbePage, kept: Kept, mode: ui.select) -> Refresh:
    """Measures a face, an angle, a boss or a reference position, as far as the machine file has them."""
    view, t = at.view, at.view.t
    with view.card("probe.others"):
        with ui.row().classes("items-end hil-fields"):
            choices = {name: t(f"probe.features.{name}") for name in at.config.features}
            chosen = ui.select(choices, label=t("probe.feature"), value=next(iter(choices)))
            view.named(chosen, "probe.feature")

            async def start() -> None:
                store, known = at.store, None if kept.value is None else kept.value.in_force
                if store is not None and known is not None:
                    await at.ask_and_run(probe.feature_job(at.config, store, known, str(chosen.value), str(mode.value)))

            button = view.button("probe.measure_other", start)
        table = ScreenTable(
            view, "probe.other", [f"probe.other_head.{name}" for name in ("what", "corrected", "uncorrected")]
        )
    latest = Latest()

    def refresh() -> None:
        button.allow(at.why_not() or _no_run_out(at, kept))
        found = result_at(view.desks, probe.OTHER, FeatureMeasurement)
        if found is not None and latest.is_new(found):
            title, both = t(f"probe.features.{found.name}"), (found.corrected, found.uncorrected)
            table.show(
                [
                    [f"{title}: {t(f'probe.results.{name}')}", *(_figure(at, name, one[name]) for one in both)]
                    for name in found.corrected
                ]
            )

    return refresh


def _figure(at: ProbePage, name: str, value: float) -> str:
    digits = 1 if name.endswith("_um") else 5 if name.endswith("_deg") else 4
    return at.view.t.number(value, digits)


@dataclass(frozen=True)
class ProbePage:
    """The probe's page in one browser."""

    view: View
    config: ProbeMachineConfig

    @property
    def store(self) -> RunOutStore | None:
        """The store as far as it is open to this browser; None for a sealed one that is not."""
        config, view = self.config, self.view
        return store_at(config, view.desk) if view.in_control or not config.store.sealed else None

    @property
    def lent(self) -> list[Desk]:
        """The desks of other axes of this server that belong to the machine."""
        return lent(self.config, self.view.desks, self.view.desk)

    @property
    def not_controlled(self) -> list[Desk]:
        """Those of them that this browser does not control."""
        tokens = self.view.browser.tokens
        return [desk for desk in self.lent if not desk.control.holds(tokens.get(desk.name))]

    @property
    def can_start(self) -> bool:
        """This browser controls every axis that has to be released, each is connected, and no job of the probe runs."""
        job = last_at(self.view.desks)
        idle = job is None or not job.running
        return self.view.can_start and idle and not self.not_controlled and all(one.live.connected for one in self.lent)

    def why_not(self) -> str:
        """Why no job of the probe can be started here, "" where it can."""
        why, t = self.view.why_not(), self.view.t
        return why or ("" if self.can_start else t("why.other_axes"))

    async def ask_and_run(self, job: Job) -> None:
        """Asks and runs as the view does, with the axes that have to be released."""
        await self.view.ask_and_run(job, self.lent)
