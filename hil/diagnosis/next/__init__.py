"""The next measurement: campaigns designed, checked, and chosen to separate causes."""
