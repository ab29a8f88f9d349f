"""Model check of the motion gate: every state from which a frame that moves a motor could be sent."""
