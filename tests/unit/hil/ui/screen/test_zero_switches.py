"""What a person says of the axis's zero on the screen: for one job, named in its question, and forgotten afterwards."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from support.bench_axis import lay_out
from support.screen import Draw, Screen, inside

from drivers.errors import InputError, LinkLostError
from hil.axis.axis_file import load_axis
from hil.calibration import job as calibrate
from hil.calibration import page as calibrate_page
from hil.calibration.explore import Exploration
from hil.desk.desk import Desk
from hil.desk.job import Job, Workplace
from hil.desk.zero_statement import ZeroStatement
from hil.diagnosis.loop import page as loop_page
from hil.diagnosis.loop.job import loop_job
from hil.diagnosis.loop.procedure import Turning
from hil.lost_motion import job as lost_motion
from hil.lost_motion import page as lost_motion_page
from hil.ui.screen.pieces import FolderContents
from hil.ui.screen.plan_question import plan_question
from hil.ui.screen.view import View


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(load_axis(lay_out(tmp_path)))


class Answered(Screen):
    """A page whose jobs are answered `yes` and not run."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, desk: Desk, draw: Draw) -> None:
        self.yes, self.jobs = True, list[Job]()

        async def answer(_view: View, job: Job) -> bool:
            self.jobs.append(job)
            return self.yes

        monkeypatch.setattr(View, "ask_and_run", answer)
        super().__init__(desk, draw)


def draw_loop(view: View) -> None:
    loop_page.draw_loop(view, cast(Any, view.desk.axis), FolderContents(view, lambda: cast(Any, None)))


def test_a_new_zero_is_asked_for_by_a_switch_named_in_the_question_and_switched_off_again(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def work() -> None:
        screen = Answered(monkeypatch, desk, calibrate_page.draw)
        t = screen.view.t
        switches = [screen.named(f"calibrate.{name}") for name in ("new_zero", "instrument_zeroed")]
        await screen.presses("calibrate.start")
        plan = screen.jobs[-1].plan
        assert (plan.new_zero, plan.instrument_zeroed) == (False, False)
        for switch in switches:
            switch.value = True
        screen.yes = False  # thought better of it
        await screen.presses("calibrate.start")
        assert all(switch.value for switch in switches)
        screen.yes = True
        await screen.presses("calibrate.start")
        plan = screen.jobs[-1].plan
        assert (plan.new_zero, plan.instrument_zeroed) == (True, True)
        assert {t("plan.new_zero"), t("plan.instrument_zeroed")} <= set(plan_question(plan, t))
        assert not any(switch.value for switch in switches)

    inside(work)


@pytest.mark.parametrize(
    ("draw", "name", "button"),
    [
        (calibrate_page.draw, "calibrate", "calibrate.verify"),
        (lost_motion_page.draw, "lost_motion", "lost_motion.start"),
        (draw_loop, "loop", "loop.start"),
    ],
)
def test_every_job_that_the_terminal_lets_be_told_of_the_instrument_can_be_told_here(
    desk: Desk, monkeypatch: pytest.MonkeyPatch, draw: Draw, name: str, button: str
) -> None:
    async def work() -> None:
        screen = Answered(monkeypatch, desk, draw)
        screen.named(f"{name}.instrument_zeroed").value = True
        await screen.presses(button)
        plan = screen.jobs[-1].plan
        assert (plan.new_zero, plan.instrument_zeroed) == (False, True)
        assert not screen.named(f"{name}.instrument_zeroed").value

    inside(work)


def test_the_session_goes_by_it_for_that_job_alone(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """The screen's session outlasts the job: what ended early must not take the zero anew in the next one."""
    axis, said = cast(Any, desk.axis), ZeroStatement(anew=True, instrument_zeroed=True)
    keeper = SimpleNamespace(anew=False, instrument_zeroed=False)
    machine = SimpleNamespace(session=SimpleNamespace(zero=keeper, conditions=None), axis=axis)
    place: Any = SimpleNamespace(
        axis=axis,
        store=None,
        machine=lambda: machine,
        opened_store=lambda: None,
        listener=None,
        tell=print,
        computing=None,
    )
    seen: list[tuple[bool, bool]] = []

    def ends_early(*_args: object, **_more: object) -> None:
        seen.append((keeper.anew, keeper.instrument_zeroed))
        raise LinkLostError("pulled")

    for module, name in (
        (calibrate, "run_calibration"),
        (calibrate, "run_verification"),
        (lost_motion, "run_lost_motion"),
    ):
        monkeypatch.setattr(module, name, ends_early)
    monkeypatch.setattr("hil.diagnosis.loop.job.run_loop", ends_early)
    for job in (
        calibrate.calibration_job(axis, zero=said),
        calibrate.verification_job(axis, corrected=False, zero=said),
        lost_motion.measuring_job(axis, lost_motion.lost_motion_config(axis), zero=said),
        loop_job(axis, Turning(Exploration()), zero=said),
    ):
        with pytest.raises(LinkLostError):
            job.work(cast(Workplace, place))
        assert seen[-1] == (True, True)
        assert (keeper.anew, keeper.instrument_zeroed) == (False, False)


def test_a_resumed_calibration_takes_no_zero_anew(desk: Desk) -> None:
    with pytest.raises(InputError, match="takes no new zero"):
        calibrate.calibration_job(cast(Any, desk.axis), resume=True, zero=ZeroStatement(anew=True))
