"""One module a campaign, each with a ``CAMPAIGN``. They know the bench, never each other."""
