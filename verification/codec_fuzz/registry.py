"""Registry of the fuzzed codecs, from the registry of families."""

from __future__ import annotations

from verification.families.campaigns import family_campaigns

FUZZED_CODECS = {codec.name: codec for campaign in family_campaigns().values() for codec in campaign.fuzzed_codecs}
