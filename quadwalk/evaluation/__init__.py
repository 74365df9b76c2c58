"""Evaluation: policies rolled out, measured and shown. Called, it is `quadwalk.api.evaluate`."""
