"""Parts of the loop's job that load without the diagnosis: its plan and its stored results."""
