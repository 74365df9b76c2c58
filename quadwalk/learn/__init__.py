"""Training: a learner, its runs, and how it goes. Called, it is `quadwalk.api.train`."""
