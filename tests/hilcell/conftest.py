"""Property tests judge results, not seconds: wall time says nothing on a busy machine."""

from hypothesis import settings

settings.register_profile("hilcell", deadline=None)
settings.load_profile("hilcell")
