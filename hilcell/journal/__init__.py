"""The records of a run: the journal, its log, and the index of all runs."""
