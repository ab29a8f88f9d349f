"""Settings of every test: no property test is timed, because a busy machine may stop in the middle of one."""

from __future__ import annotations

from hypothesis import HealthCheck, settings

settings.register_profile("untimed", deadline=None, suppress_health_check=[HealthCheck.too_slow])
if settings.get_current_profile_name() == "default":  # a mutation run has its own
    settings.load_profile("untimed")
