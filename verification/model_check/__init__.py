"""Model check of the permissives: every state from which a frame that moves a motor could be sent."""
