"""`quadwalk.settings.environment`, where the task files of earlier runs import it from."""

from quadwalk.settings.environment import *  # noqa: F403
