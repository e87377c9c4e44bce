"""The next measurement: campaigns designed, checked, and chosen to tell causes apart."""
