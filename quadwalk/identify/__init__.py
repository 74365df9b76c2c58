"""From a robot's recorded joints to the settings of training."""
