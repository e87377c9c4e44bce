"""Contents of the screen's page on parameter sets."""

from __future__ import annotations

from dataclasses import dataclass

from hil.desk.desk import Desk
from hil.desk.progress import Progress
from hil.parameters import job as parameters
from hil.parameters.listing import Listing
from hil.parameters.outcome import Outcome, outcome_of

KINDS = (
    parameters.BACKUP,
    parameters.COMPARE,
    parameters.VERIFY,
    parameters.DOWNLOAD,
    parameters.STORE,
    parameters.RESTORE,
    parameters.RESUME,
    parameters.ROLLBACK,
)


@dataclass(frozen=True)
class ParametersScreen(Outcome):
    """The outcome of the last job. job: the latest of this page and this server with an outcome, running or over, None for none;
    latest: also one that reads the list; listing: the list as last read, None for none."""

    job: Progress | None = None
    latest: Progress | None = None
    listing: Listing | None = None


def parameters_screen(desk: Desk, kept: Outcome | None = None) -> ParametersScreen:
    """The contents at this moment. kept: the outcome of a server before this one, shown until there is a job of this one."""
    job, read = desk.last_of(KINDS), desk.last(parameters.READ)
    found = (kept or Outcome()) if job is None else outcome_of(job.result)
    listing = None if read is None or not isinstance(read.result, Listing) else read.result
    return ParametersScreen(**vars(found), job=job, latest=desk.last_of((*KINDS, parameters.READ)), listing=listing)
