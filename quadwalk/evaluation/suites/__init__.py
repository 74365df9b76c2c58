"""Suites of an evaluation, one per kind of task: what it measures beside the metrics of episodes.

A task names its own (`TrainConfig.suite`); "course" measures nothing more.
"""
