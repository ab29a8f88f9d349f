"""Second reading of the drives' manuals: frames, replies and effects of requests, sharing no line with the product."""
