"""A line in virtual time with its drives, the people who use it, and the witness who watches both."""
