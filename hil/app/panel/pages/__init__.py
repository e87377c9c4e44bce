"""The pages, in the order of the navigation, each with its jobs and the campaigns that it resumes. A new one is added here."""

from functools import partial

from hil.app.panel.bar import Page
from hil.app.panel.pages import overview
from hil.backlash import page as backlash
from hil.calibration import page as calibrate
from hil.calibration.job import CALIBRATE, UNCORRECTED, VERIFY
from hil.diagnosis import page as diagnosis
from hil.diagnosis.loop.jobs.plan import CLOSE_LOOP
from hil.lost_motion import page as lost_motion
from hil.lost_motion.job import CAMPAIGN as LOST_MOTION
from hil.parameters import page as parameters
from hil.probe import page as probe
from hil.probe.machine_file import ProbeMachineConfig
from hil.report import page as reports
from hil.script import page as procedure_page
from hil.script.procedure import Procedure


def pages(probe_machine: ProbeMachineConfig | None, procedure: type[Procedure] | None = None) -> tuple[Page, ...]:
    """All pages. probe_machine: the machine with a touch probe; procedure: a user's own; None for none."""
    own = () if procedure is None else (_own_page(procedure),)
    return (
        Page("overview", overview.draw),
        Page("axes", overview.draw_axes, several=True),
        Page("calibrate", calibrate.draw, resumes=(CALIBRATE, VERIFY, UNCORRECTED)),
        Page("backlash", backlash.draw, jobs=("backlash",)),
        Page("lost_motion", lost_motion.draw, jobs=("lost motion", "circle"), resumes=(LOST_MOTION,)),
        Page("probe", partial(probe.draw, machine=probe_machine), jobs=("probe",)),
        *own,
        Page("diagnosis", diagnosis.draw, jobs=(CLOSE_LOOP,), resumes=(CLOSE_LOOP,)),
        Page("parameters", parameters.draw, jobs=("parameters",)),
        Page("reports", reports.draw),
    )


def _own_page(procedure: type[Procedure]) -> Page:
    kinds = (procedure.kind,)
    return Page("procedure", partial(procedure_page.draw, procedure=procedure), jobs=kinds, resumes=kinds)
