"""Second opinions: may these bytes be taken for a frame? Written plainly from the manuals, sharing no line with
``protocols``: no codec, no table, no check sum of theirs. A codec and its judge must agree on every byte string.

A judge takes the bytes of the request as they were sent (none: the station's side, where a request is to be heard) and
the bytes that came. It answers how many of them are the frame, or None. ``sound`` looks at nothing but the check, and
``seal`` gives a frame its right one.

forms     which bytes may stand where, to compute how often chance alone hits a frame
"""
