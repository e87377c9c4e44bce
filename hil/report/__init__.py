"""`hil report`: the report of an axis, its certificate, and the reports that the screen makes."""
