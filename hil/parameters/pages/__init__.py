"""Parts of the screen's page on parameters."""
