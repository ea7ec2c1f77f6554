"""Plans of work: which stations for which holes, in which order."""
