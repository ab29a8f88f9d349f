"""``--service``: the commands on a running service, which owns the buses, so that none is opened twice."""
