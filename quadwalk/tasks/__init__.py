"""The tasks: one file is one task, with all of its numbers."""
