"""The noise of a campaign: its model, the evidence under it, and the rows it is fitted to."""
