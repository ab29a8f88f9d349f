"""Users, their rights, and how a request proves its user."""
