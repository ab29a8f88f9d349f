"""Public kits for tests: virtual time (``virtual``), scripted ports (``playbook``), conformance of codecs (``codec_kit``)."""
