# SPDX-License-Identifier: Apache-2.0
"""Settings for every test of the suite."""

from hypothesis import HealthCheck, settings

# A busy machine is no failure: no test of this suite is about time.
settings.register_profile("softgrip", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("softgrip")
