"""What the jobs of all rooms share, for command line and screen: plan, workplace, worker process and summaries."""
