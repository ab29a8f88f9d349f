"""Public kits for tests: virtual time (``virtual``), scripted ports (``playbook``), codecs (``codec_kit``)."""
