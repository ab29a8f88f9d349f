"""Comparison of the product's C320 and DZB100 codecs with the reference codecs on the same random messages."""
