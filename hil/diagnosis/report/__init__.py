"""The diagnosis's part of a report."""
