"""Many trainings: `quadwalk compare` and `quadwalk tune`, on this machine or on a Ray cluster."""
