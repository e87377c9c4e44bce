"""Many axes over years: an index of their campaigns, ageing found at a stated rate of false alarms, and what to look
at first."""
