"""What an episode begins with: place and pose, command, conditions."""
