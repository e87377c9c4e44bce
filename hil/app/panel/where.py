"""Where the axis is, how far it has to go, and the step now running: the same on every page that measures."""

from __future__ import annotations

from collections.abc import Callable

from hil.app.desk.progress import Progress
from hil.app.panel.view import View


def draw_where(view: View, page: str, job: Callable[[], Progress | None]) -> Callable[[], None]:
    """In the card at hand, with names that begin with the page's; returns what refreshes it. job: whose step is shown."""
    position = view.value("overview.position", "mm", name=f"{page}.position")
    remaining = view.value("overview.remaining", "mm", small=True, name=f"{page}.remaining")
    step = view.value(f"{page}.step", small=True)

    def refresh() -> None:
        position.set_text(view.t.number(view.desk.live.position_load_mm))
        remaining.set_text(view.t.number(view.desk.live.remaining_mm))
        step.set_text(view.stage(job()))

    return refresh
