"""The pages, in the order of the navigation. One file each; a new one is added here."""

from functools import partial

from hil.app.panel.bar import Page
from hil.app.panel.pages import axes, overview
from hil.backlash import page as backlash
from hil.calibration import page as calibrate
from hil.diagnosis import page as diagnosis
from hil.lost_motion import page as lost_motion
from hil.parameters import page as parameters
from hil.probe import page as probe
from hil.probe.machine_file import ProbeMachineConfig
from hil.report import page as reports
from hil.script import page as procedure_page
from hil.script.procedure import Procedure


def pages(probe_machine: ProbeMachineConfig | None, procedure: type[Procedure] | None = None) -> tuple[Page, ...]:
    """All pages. probe_machine: the machine with a touch probe; procedure: a user's own; None for none."""
    own = () if procedure is None else (Page("procedure", partial(procedure_page.draw, procedure=procedure)),)
    return (
        Page("overview", overview.draw),
        Page("axes", axes.draw, several=True),
        Page("calibrate", calibrate.draw),
        Page("backlash", backlash.draw),
        Page("lost_motion", lost_motion.draw),
        Page("probe", partial(probe.draw, machine=probe_machine)),
        *own,
        Page("diagnosis", diagnosis.draw),
        Page("parameters", parameters.draw),
        Page("reports", reports.draw),
    )
