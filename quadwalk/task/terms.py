"""`quadwalk.settings.terms`, where the task files of earlier runs import it from."""

from quadwalk.settings.terms import *  # noqa: F403
