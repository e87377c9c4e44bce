"""The drive's backlash parameter as the screen's buttons change it: written, off and on, and the original back."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.backlash_axis import lay_out

from drivers.clock import Waiting
from drivers.drive import ServoDrive
from drivers.errors import StateError
from hil.axis import DriveAxis, load_drive_axis
from hil.backlash_settings import backlash_settings
from hil.jobs import backlash
from hil.jobs.backlash import Compensating
from hil.jobs.job import Job, Workplace
from hil.procedures.events import silent
from hil.procedures.neutral_settings import neutral
from hil.wiring import connected_drive


class Here:
    """The axis, connected, without a desk."""

    def __init__(self, axis: DriveAxis, drive: ServoDrive) -> None:
        self.axis, self.drive = axis, drive
        self.how = backlash.backlash_config(axis)

    def does(self, job: Job) -> Compensating:
        waiting: Waiting = None  # type: ignore[assignment]
        place = Workplace(self.axis, self.drive, None, silent, lambda _text: None, None, waiting, lambda *_: None)
        result = job.work(place)
        assert isinstance(result, Compensating)
        return result

    def amount(self) -> float:
        return backlash_settings(self.axis, self.how, self.drive).amount.read()


@pytest.fixture(params=["virtual", "canopen", "modbus-tcp"])
def here(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Here]:
    axis = load_drive_axis(lay_out(tmp_path, request.param))
    with connected_drive(axis) as drive:
        yield Here(axis, drive)


def test_written_off_on_and_back(here: Here) -> None:
    settings = backlash_settings(here.axis, here.how, here.drive)
    settings.amount.write(700.0)  # what its builder left
    seen = here.does(backlash.look_job(here.axis, here.how))
    assert (seen.amount, seen.original, seen.written, seen.on) == (700.0, None, None, True)

    seen = here.does(backlash.write_job(here.axis, here.how, 53.4))
    assert here.amount() * seen.amount_um == pytest.approx(53.4)
    assert seen.original == 700.0
    written = seen.amount
    seen = here.does(backlash.write_job(here.axis, here.how, 54.0))
    assert seen.original == 700.0  # not our own first one

    seen = here.does(backlash.switch_job(here.axis, here.how, on=False))
    assert (seen.on, here.amount()) == (False, 0.0)
    seen = here.does(backlash.switch_job(here.axis, here.how, on=False))
    assert seen.original == 700.0
    seen = here.does(backlash.switch_job(here.axis, here.how, on=True))
    assert seen.amount * seen.amount_um == pytest.approx(54.0)
    assert seen.amount > written

    seen = here.does(backlash.restore_job(here.axis, here.how))
    assert (here.amount(), seen.original, seen.written) == (700.0, None, None)
    with pytest.raises(StateError, match="nothing to restore"):
        here.does(backlash.restore_job(here.axis, here.how))


def test_what_an_interruption_left_goes_first_and_needs_no_builder(here: Here) -> None:
    settings = backlash_settings(here.axis, here.how, here.drive)
    settings.amount.write(700.0)
    assert backlash.restore_job(here.axis, here.how).plan.locked
    with neutral(settings, lambda _text: None):
        noted = settings.note.read_bytes()
    settings.amount.write(0.0)  # as a process that was killed leaves it
    settings.note.write_bytes(noted)
    job = backlash.restore_job(here.axis, here.how)
    assert not job.plan.locked
    assert here.does(job).amount == 700.0
    assert not backlash.unrestored(here.axis)


def test_nothing_to_switch_on(here: Here) -> None:
    backlash_settings(here.axis, here.how, here.drive).amount.write(0.0)
    with pytest.raises(StateError, match="no amount to switch on"):
        here.does(backlash.switch_job(here.axis, here.how, on=True))


def test_whatever_changes_the_parameter_to_stay_is_locked(here: Here) -> None:
    locked = [
        backlash.write_job(here.axis, here.how, 50.0),
        backlash.switch_job(here.axis, here.how, on=False),
        backlash.restore_job(here.axis, here.how),
    ]
    assert all(job.plan.locked and job.plan.writes for job in locked)
    assert not backlash.measuring_job(here.axis, here.how).plan.locked
    assert not backlash.look_job(here.axis, here.how).plan.writes
