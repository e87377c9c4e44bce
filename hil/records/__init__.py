"""Records: rows, the journal that keeps them as they come, the chain that proves them unchanged, the zero they were taken in."""
