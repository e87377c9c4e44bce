"""The noise of a campaign: its model, the evidence under it, and how large chance gets."""
