"""Whatever goes wrong in a download, at whichever frame: in the end the drive is entirely old or entirely new, and the report is true.

Thinned out here; `python tests/study/params_every_frame.py` does it at every frame.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from study.params_every_frame import study
from support.parameter_faults import KINDS, cases, one_run
from support.parameter_rigs import maker_eds

from hil.parameters.report import Ending

EVERY = 53


@pytest.mark.parametrize("kind", KINDS)
def test_entirely_old_or_entirely_new(kind: str, tmp_path: Path) -> None:
    tally = study(kind, tmp_path, EVERY, first=KINDS.index(kind))
    print(tally)
    assert tally.runs >= 3
    assert not tally.broken


def test_a_drive_that_starts_anew_before_it_stores_has_not_stored_the_new(tmp_path: Path) -> None:
    eds = maker_eds(tmp_path, 40)
    clean = one_run(eds, tmp_path / "clean")
    assert (clean.said, clean.held, clean.flash, clean.whole) == (Ending.WRITTEN, "new", "new", True)
    faults, _ = list(cases(clean, "node reboot"))[-3]
    assert one_run(eds, tmp_path / "reboot", *faults).whole


@pytest.mark.parametrize("forward", [True, False])
def test_a_killed_process_is_gone_on_from(tmp_path: Path, forward: bool) -> None:
    run = one_run(maker_eds(tmp_path, 40), tmp_path / "killed", dies_at=170, forward=forward)
    assert (run.at_last, run.whole) == (Ending.WRITTEN if forward else Ending.PUT_BACK, True)


@pytest.mark.parametrize("forward", [True, False])
def test_killed_again_and_again_it_is_still_finished(tmp_path: Path, forward: bool) -> None:
    """Each attempt to finish is killed a little later than the last one."""
    run = one_run(maker_eds(tmp_path, 40), tmp_path / "killed", dies_at=150, forward=forward, deaths=(3, 50, 100, 120))
    assert (run.at_last, run.whole) == (Ending.WRITTEN if forward else Ending.PUT_BACK, True)
