"""Parts of the loop's job: its plan, its person, what it stored."""
