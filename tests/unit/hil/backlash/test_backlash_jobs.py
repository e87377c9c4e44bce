"""The drive's backlash parameter as the screen's buttons change it: written, off and on, and the original back."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from support.backlash_axis import lay_out

from drivers.clock import Waiting
from drivers.drive import ServoDrive
from drivers.errors import InputError, StateError
from hil.axis.axis_file import DriveAxis, load_drive_axis
from hil.axis.backlash import BacklashConfig
from hil.backlash import job as backlash
from hil.backlash.job import CompensationState
from hil.backlash.neutral_settings import BacklashSettings, Setting, neutral
from hil.backlash.settings import backlash_settings
from hil.desk.job import Job, Workplace
from hil.machine.events import silent
from hil.machine.wiring import connected_drive


class Here:
    """The axis, connected, without a desk."""

    def __init__(self, axis: DriveAxis, drive: ServoDrive) -> None:
        self.axis, self.drive = axis, drive
        self.how = backlash.backlash_config(axis)

    def does(self, job: Job) -> CompensationState:
        waiting: Waiting = None  # type: ignore[assignment]
        place = Workplace(self.axis, self.drive, None, silent, lambda _text: None, None, waiting, lambda *_: None)
        result = job.work(place)
        assert isinstance(result, CompensationState)
        return result

    def amount(self) -> float:
        return backlash_settings(self.axis, self.how, self.drive).amount.read()


@pytest.fixture(params=["canopen", "modbus-tcp"])
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


def test_a_second_answer_to_the_same_question_undoes_nothing_that_was_written(here: Here) -> None:
    """Two dialogs are open, in two browsers: what needs no builder puts back an interruption, and nothing else."""
    settings = backlash_settings(here.axis, here.how, here.drive)
    written = here.does(backlash.write_job(here.axis, here.how, 53.0))
    with neutral(settings, lambda _text: None):
        noted = settings.note.read_bytes()
    settings.amount.write(0.0)  # as a process that was killed leaves it
    settings.note.write_bytes(noted)
    first, second = (backlash.restore_job(here.axis, here.how) for _ in range(2))
    assert here.does(first) == written
    with pytest.raises(StateError, match="put back already"):
        here.does(second)
    assert here.does(backlash.look_job(here.axis, here.how)) == written


class PowerCut(BaseException):
    """Nothing of ours runs after it."""


@dataclass(frozen=True)
class LastWrite:
    """A setting during whose write of this number the power fails: the drive has the value."""

    setting: Setting
    writes: list[float]
    number: int

    @property
    def name(self) -> str:
        return self.setting.name

    @property
    def resolution(self) -> float:
        return self.setting.resolution

    def read(self) -> float:
        return self.setting.read()

    def write(self, value: float) -> None:
        self.writes.append(value)
        self.setting.write(value)
        if len(self.writes) == self.number:
            raise PowerCut


def power_fails(monkeypatch: pytest.MonkeyPatch, number: int) -> None:
    """While the amount is written for the n-th time."""

    def settings(axis: DriveAxis, how: BacklashConfig, drive: ServoDrive) -> BacklashSettings:
        found = backlash_settings(axis, how, drive)
        return replace(found, amount=LastWrite(found.amount, [], number))

    monkeypatch.setattr(backlash, "backlash_settings", settings)


def has_its_original_back(here: Here, original: float) -> None:
    """Everything starts anew: the original is known, and is restored."""
    assert here.amount() not in (0.0, original)
    assert here.does(backlash.look_job(here.axis, here.how)).original == original
    assert here.does(backlash.restore_job(here.axis, here.how)).amount == original


def test_a_power_cut_while_it_is_written_does_not_cost_the_original(
    here: Here, monkeypatch: pytest.MonkeyPatch
) -> None:
    backlash_settings(here.axis, here.how, here.drive).amount.write(700.0)
    with monkeypatch.context() as during:
        power_fails(during, 1)
        with pytest.raises(PowerCut):
            here.does(backlash.write_job(here.axis, here.how, 53.0))
    has_its_original_back(here, 700.0)


def test_nor_after_a_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """0, as before, and then the mean."""
    axis = load_drive_axis(lay_out(tmp_path, "canopen"))
    with connected_drive(axis) as drive:
        here = Here(axis, drive)
        backlash_settings(axis, here.how, drive).amount.write(700.0)
        with monkeypatch.context() as during:
            power_fails(during, 3)
            with pytest.raises(PowerCut):
                backlash.measure(axis, here.how, drive, write=True, tell=lambda _text: None)
        has_its_original_back(here, 700.0)


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


def test_of_a_drive_without_a_parameter_nothing_is_written_that_nothing_would_use(tmp_path: Path) -> None:
    """Its axis file ends with the drive: there are no tables to enter an amount in."""
    axis = load_drive_axis(lay_out(tmp_path))
    with connected_drive(axis) as drive:
        here = Here(axis, drive)
        assert not here.does(backlash.look_job(axis, here.how)).on
        with pytest.raises(InputError, match=r"no \[instrument\]: nothing would use the amount, so it is not written"):
            here.does(backlash.write_job(axis, here.how, 53.0))
