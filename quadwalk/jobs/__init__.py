"""Many trainings at once: the same jobs in processes of this machine, or on a Ray cluster."""
