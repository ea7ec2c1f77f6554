"""KRL programs as text: which numbers are targets, and whether they can be corrected safely."""
