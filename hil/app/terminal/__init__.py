"""The command line: one module per verb that parses, calls, prints. No logic of the field lives here."""
