"""Evaluation: policies rolled out, measured and shown. Called, it is `quadwalk.api.evaluate`."""

import sys

from quadwalk import CallablePackage

sys.modules[__name__].__class__ = CallablePackage
