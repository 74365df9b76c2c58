"""`quadwalk compare`: what a change of settings gives, over several seeds."""
