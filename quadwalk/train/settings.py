"""`quadwalk.settings.training`, where the task files of earlier runs import it from."""

from quadwalk.settings.training import *  # noqa: F403
