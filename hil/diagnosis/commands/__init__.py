"""The commands on records: `hil diagnose`, `fit`, `apply`, `campaign`."""
