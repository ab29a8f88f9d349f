"""DZB100 in the campaigns."""
