"""The verbs on records: `hil diagnose`, `fit`, `apply`, `campaign`."""
