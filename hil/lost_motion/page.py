"""Page of lost motion by the instrument (system C): measure, compare five shapes, prove, store; and the circle of two
axes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import ui

from hil.axis.axis_file import AxisConfig
from hil.figures.error_figures import rms
from hil.lost_motion import job as lost_motion
from hil.lost_motion.circle.page import draw_circle
from hil.lost_motion.estimate import separately_determined
from hil.lost_motion.measured import ReversalResult
from hil.lost_motion.page_data import KeptLostMotion, kept_lost_motion, lost_motion_screen, proof_points, rise_curves
from hil.records.rows import UM_PER_MM
from hil.ui.screen.drawings import Curve, Options, RedrawnChart, curves
from hil.ui.screen.pieces import (
    FolderContents,
    Latest,
    ScreenTable,
    Steps,
    draw_ready,
    draw_where,
    lead,
    measured_checks,
)
from hil.ui.screen.plots import JobPlot
from hil.ui.screen.unfinished import GoOn, draw_unfinished
from hil.ui.screen.view import Refresh, View
from hil.ui.screen.zero_switches import ZeroSwitches


def draw(view: View) -> None:
    axis = view.desk.axis
    if not isinstance(axis, AxisConfig):
        view.named(ui.label(view.t("lost_motion.no_instrument")).classes("hil-note"), "lost_motion.no_instrument")
        return
    messages = view.messages("lost_motion.messages")
    ways: dict[str, GoOn] = {}
    interrupted = draw_unfinished(view, "lost_motion", ways)
    with ui.element("div").classes("hil-job-page"):
        with ui.element("div").classes("hil-side"):
            kept = FolderContents(view, partial(kept_lost_motion, axis))
            parts = [
                _draw_found(view, kept),
                _draw_proof(view, kept),
                draw_where(view, "lost_motion", lambda: lost_motion_screen(view.desk).measurement),
                _draw_buttons(view, axis, ways, interrupted),
            ]
        with ui.element("div").classes("hil-main"):
            parts.append(_draw_steps(view))
            parts.append(_draw_rows(view))
            view.how("lost_motion.instructions", "lost_motion.steps")
    parts += [_draw_plots(view), _draw_fits(view), draw_circle(view, axis)]

    def tell() -> None:
        shown = lost_motion_screen(view.desk)
        messages.show(shown.measurement, "\n".join(map(view.t.said, shown.warnings)))

    view.every(tell, *parts)


def _draw_buttons(view: View, axis: AxisConfig, ways: dict[str, GoOn], interrupted: Callable[[], bool]) -> Refresh:
    """Start, store; and the way to go on with an interrupted measurement."""
    t, desk, how = view.t, view.desk, lost_motion.lost_motion_config(axis)
    figures = {name: t.number(value, 1) for name, value in (("stroke", how.stroke_mm), ("at", how.at_mm))}
    plan = t("lost_motion.plan", runs=how.runs, places=how.places, moves=how.proof_moves, **figures)
    view.named(ui.label(plan).classes("hil-name"), "lost_motion.plan")

    async def start(resume: bool) -> None:
        await zero.run(view.ask_and_run, lost_motion.measuring_job(axis, how, resume=resume, zero=zero.said()))

    async def store() -> None:
        measured = lost_motion_screen(desk).measured
        if measured is not None:
            new = t.number(measured.raw.estimate.amount_um, 2)
            before = None if measured.present is None else measured.present.rise
            old = t.number(None if before is None else before.amount_um, 2)
            change = view.change(t("lost_motion.amount"), old, new, "µm")
            await view.ask_and_run(lost_motion.store_job(axis, measured), changes=[change])

    ready = draw_ready(view, "lost_motion", *measured_checks(view))
    with ui.element("div").classes("hil-buttons"):
        start_button = view.button("lost_motion.start", lambda: start(False)).classes("hil-go")
        store_button = view.button("lost_motion.store", store)
        zero = ZeroSwitches(view, "lost_motion")

    ways[lost_motion.CAMPAIGN] = GoOn("lost_motion.resume", lambda: start(True), view.why_not)

    def refresh() -> None:
        ready()
        start_button.allow(view.why_not())
        zero.refresh()
        storable = lost_motion_screen(desk).storable
        main = store_button if storable else None if interrupted() else start_button
        lead(main, [start_button, store_button])
        store_button.allow(view.why_not(builder=True) or ("" if storable else t("why.nothing_proven")))

    return refresh


def _earlier(view: View, kept: FolderContents[KeptLostMotion | None]) -> KeptLostMotion | None:
    """The result of a server before this one; None as soon as there is a measurement of this one."""
    return kept.value if lost_motion_screen(view.desk).measurement is None else None


def _draw_found(view: View, kept: FolderContents[KeptLostMotion | None]) -> Refresh:
    """The lost motion, its uncertainty and its shape."""
    t = view.t
    with view.card("lost_motion.found"):
        amount = view.value("lost_motion.amount", "µm")
        with ui.element("div").classes("hil-lines"):
            std = view.value("lost_motion.std", "µm", small=True)
            shape = view.value("lost_motion.shape", small=True)
        date = view.named(ui.label().classes("hil-name"), "lost_motion.kept")

    def refresh() -> None:
        measured, earlier = lost_motion_screen(view.desk).measured, _earlier(view, kept)
        date.set_text("" if earlier is None else t("backlash.kept", date=earlier.at.strftime("%Y-%m-%d %H:%M")))
        if earlier is not None:
            amount.set_text(t.number(earlier.amount_um, 2))
            std.set_text(t.number(earlier.std_um, 3))
            shape.set_text(_shape(view, earlier.shape))
            return
        found = None if measured is None else measured.raw.estimate
        amount.set_text(t.number(None if found is None else found.amount_um, 2))
        std.set_text("–" if found is None else t.number(found.parameters["amount_um"].std, 3))
        shape.set_text("–" if found is None else _shape(view, found.rise.shape.name))

    return refresh


def _draw_proof(view: View, kept: FolderContents[KeptLostMotion | None]) -> Refresh:
    """The proof by fresh moves, and whether the result is stored."""
    t = view.t
    with view.card("lost_motion.proof"), ui.element("div").classes("hil-lines"):
        after = view.value("lost_motion.after", "µm", small=True)
        before = view.value("lost_motion.before", "µm", small=True)
        over = view.value("lost_motion.over", "%", small=True)
        state = view.value("lost_motion.state", small=True)

    def refresh() -> None:
        shown, earlier = lost_motion_screen(view.desk), _earlier(view, kept)
        if earlier is not None:
            after.set_text(t.number(earlier.after_um, 2))
            before.set_text(t.number(earlier.before_um, 2))
            over.set_text(t.number(earlier.over_percent, 1))
            return
        proof = None if shown.measured is None else shown.measured.raw.proof
        after.set_text(t.number(None if proof is None else rms(proof.after_um), 2))
        before.set_text(t.number(None if proof is None else rms(proof.before_um), 2))
        over.set_text(t.number(None if proof is None else 100.0 * proof.over_um / proof.amount_um, 1))
        good = "good" if shown.storable else "bad"
        state.set_text("–" if proof is None else t(f"lost_motion.{'stored' if shown.stored else good}"))

    return refresh


def _draw_steps(view: View) -> Refresh:
    steps = Steps(view, "lost_motion", ("strokes", "fit", "before", "after"))
    return lambda: steps.follow(lost_motion_screen(view.desk).measurement)


def _draw_rows(view: View) -> Refresh:
    """The readings as they come."""
    with view.card("lost_motion.rows", name="lost_motion.rows.card"):
        x, y = view.t("lost_motion.target_x"), view.t("lost_motion.error_y")
        return JobPlot(view, lost_motion.MEASURE, x, y, name="lost_motion.rows", dots=True).refresh


def _draw_plots(view: View) -> Refresh:
    """The lost motion after each reversal with the fitted shapes, and the proof."""
    with ui.element("div").classes("hil-grid wide"):
        drawings = []
        for key in ("lost_motion.rise", "lost_motion.beginning", "lost_motion.moves"):
            with view.card(key, name=f"{key}.card"):
                drawings.append(RedrawnChart(view, key))
    rise, beginning, moves = drawings

    def refresh() -> None:
        measured = lost_motion_screen(view.desk).measured
        if measured is not None:
            rise.show(measured, lambda: _rise(view, measured, beginning=False))
            beginning.show(measured, lambda: _rise(view, measured, beginning=True))
            moves.show(measured, lambda: _moves(view, measured))

    return refresh


def _rise(view: View, measured: ReversalResult, *, beginning: bool) -> Options:
    t = view.t
    drawn = rise_curves(measured.raw.estimate, beginning=beginning)
    marks = {1: (5, False), -1: (1, True)}
    points = [
        Curve(
            t("lost_motion.plus_minus" if way < 0 else "lost_motion.minus_plus"), found, colour, "triangle", turned=turn
        )
        for way, (colour, turn) in marks.items()
        if (found := drawn.measured[way])
    ]
    fits = [Curve(_shape(view, one.name), one.points, 2, faint=not one.in_force) for one in drawn.fitted]
    x = t("lost_motion.travel_um" if beginning else "lost_motion.travel_mm")
    return curves(view, x, t("lost_motion.lost_y"), [*points, *fits])


def _moves(view: View, measured: ReversalResult) -> Options:
    t = view.t
    before, after = proof_points(measured.raw.proof)
    drawn = [Curve(t("lost_motion.without"), before, 1, "circle"), Curve(t("lost_motion.with"), after, 2, "diamond")]
    return curves(view, t("lost_motion.move_x"), t("lost_motion.left_y"), drawn)


def _draw_fits(view: View) -> Refresh:
    """The shapes compared, and the parameters of the chosen one."""
    t = view.t
    with ui.element("div").classes("hil-grid wide"):
        with view.card("lost_motion.shapes"):
            heads = [f"lost_motion.head.{name}" for name in ("shape", "amount_um", "rms_um", "held_out_um")]
            shapes = ScreenTable(view, "lost_motion.contenders", heads)
        with view.card("lost_motion.parameters"):
            heads = [f"lost_motion.head.{name}" for name in ("parameter", "value", "uncertainty")]
            parameters = ScreenTable(view, "lost_motion.fitted", heads)
            single = view.named(ui.label(t("lost_motion.not_separate")).classes("hil-note"), "lost_motion.not_separate")
            single.set_visibility(False)
    latest = Latest()

    def refresh() -> None:
        measured = lost_motion_screen(view.desk).measured
        if measured is None or not latest.is_new(measured):
            return
        found = measured.raw.estimate
        shapes.show(
            [
                [
                    _shape(view, one.fitted.shape.name)
                    + (f" ({t('lost_motion.taken')})" if one.fitted.rise is found.rise else ""),
                    t.number(one.fitted.rise.amount_um, 2),
                    t.number(one.rms_um),
                    t.number(one.held_out_rms_um),
                ]
                for one in found.contenders
            ]
        )
        parameters.show(
            [
                [t(f"lost_motion.parameter.{name}"), t.number(per * each.value, 2), t.number(per * each.std, 2)]
                for name, each in found.determined.items()
                for per in [UM_PER_MM if name.endswith("_mm") else 1.0]
            ]
        )
        single.set_visibility(not separately_determined(found.parameters))

    return refresh


def _shape(view: View, name: str) -> str:
    return view.t.known("lost_motion.shapes_by_name", name.replace(" ", "_"))
