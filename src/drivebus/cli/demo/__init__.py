"""The demo: a virtual plant with four buses, its service, and a script that the user can take over."""
