"""Training: a learner, its runs, and how it goes. Called, it is `quadwalk.api.train`."""

import sys

from quadwalk import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
