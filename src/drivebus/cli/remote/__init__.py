"""``--service``: the verbs against a running service, which owns the buses, so that none is opened twice."""
