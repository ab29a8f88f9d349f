"""The whole space of states in front of the motion gate."""
