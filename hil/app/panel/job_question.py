"""The running job's question to the operator: shown on every page, answered in the browser that holds control."""

from __future__ import annotations

from nicegui import ui

from hil.desk.asking import Pending
from hil.ui.screen.view import View

S_PER_MIN = 60.0


def draw_question(view: View) -> None:
    """Draw the question below the header; hidden while there is none."""
    t, desk = view.t, view.desk
    shown: list[Pending | None] = [None]

    def answer(*, yes: bool) -> None:
        if shown[0] is not None:
            desk.answer(view.token, shown[0].number, yes=yes)

    with view.named(ui.element("section").classes("hil-card hil-ask w-full"), "ask") as card:
        words = view.named(ui.label().style("font-size: 1.4rem"), "ask.words")
        wait = view.named(ui.label(), "ask.wait")
        elsewhere = view.named(ui.label(t("ask.elsewhere")), "ask.elsewhere")
        with ui.row() as buttons:
            done = view.button("ask.yes.run", lambda: answer(yes=True), name="ask.yes").classes("hil-go")
            not_done = view.button("ask.no.run", lambda: answer(yes=False), name="ask.no")

    def refresh() -> None:
        pending = desk.question
        card.set_visibility(pending is not None)
        buttons.set_visibility(view.in_control)
        elsewhere.set_visibility(not view.in_control)
        if pending is None or shown == [pending]:
            return
        shown[:] = [pending]
        question = pending.question
        words.set_text(t(f"ask.{question.kind}", **{name: t.said(text) for name, text in question.figures.items()}))
        done.say(t(f"ask.yes.{question.kind}"))
        not_done.say(t(f"ask.no.{question.kind}"))
        minutes = t.number(question.within_s / S_PER_MIN, 0)
        wait.set_text(f"{t(f'ask.power.{question.kind}')} {t('ask.wait', minutes=minutes)}")

    view.every(refresh)
