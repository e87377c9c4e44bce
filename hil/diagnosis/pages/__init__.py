"""Parts of the diagnosis's page."""
