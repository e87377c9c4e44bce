"""The command line: entry point, and what the verbs of all rooms share. Verbs parse arguments, call jobs and print."""
