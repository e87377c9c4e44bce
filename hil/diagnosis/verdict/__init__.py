"""The verdict: what of the search is more than noise, what rivals remain, what may be offered."""
