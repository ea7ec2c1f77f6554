"""RAPID programs as text: their targets, and whether these can be corrected safely."""
