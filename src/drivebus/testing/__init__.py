"""Public test kits: virtual time (``virtual_time``), scripted buses (``bus_script``), codecs (``codec_kit``)."""
