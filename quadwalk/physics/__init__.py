"""Physics of quadrupeds, which knows nothing of tasks; docs/physics.md describes it."""
