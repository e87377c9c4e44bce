"""Parts of the probe's page."""
