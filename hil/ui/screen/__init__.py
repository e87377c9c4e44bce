"""Elements of the screen that the pages are made of, and its texts."""
