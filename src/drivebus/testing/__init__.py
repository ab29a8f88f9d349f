"""Public kits for tests: virtual time (``virtual``), scripted ports (``playbook``)."""
