"""The pages, in the order of the navigation. One file each; a new one is added here."""

from hil.panel.frame import Page
from hil.panel.pages import axes, backlash, calibrate, diagnosis, lost_motion, overview, parameters, probe, reports

PAGES = (
    Page("overview", overview.draw),
    Page("axes", axes.draw, several=True),
    Page("calibrate", calibrate.draw),
    Page("backlash", backlash.draw),
    Page("lost_motion", lost_motion.draw),
    Page("probe", probe.draw),
    Page("diagnosis", diagnosis.draw),
    Page("parameters", parameters.draw),
    Page("reports", reports.draw),
)
