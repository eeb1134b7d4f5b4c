"""Settings of a run, and those that trade accuracy for time."""
