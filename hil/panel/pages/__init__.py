"""The pages, in the order of the navigation. One file each; a new one is added here."""

from hil.panel.frame import Page
from hil.panel.pages import backlash, calibrate, lost_motion, overview

PAGES = (
    Page("overview", overview.draw),
    Page("calibrate", calibrate.draw),
    Page("backlash", backlash.draw),
    Page("lost_motion", lost_motion.draw),
)
