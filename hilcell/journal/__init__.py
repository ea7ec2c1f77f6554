"""What a run has recorded: the journal, what it says, and the index of all runs."""
