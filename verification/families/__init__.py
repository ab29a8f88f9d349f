"""Protocol families of the campaigns: one folder a family, listed in ``registry``.

facts      variants, times and meaning of requests from the manuals; pure, shares no code with the product
campaign   exchanges, codecs, fake station, reads and frames for the campaigns, written with the product's codec
"""
