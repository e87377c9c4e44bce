"""Terminal, screen and report: their shared parts, and the program's entry point."""
