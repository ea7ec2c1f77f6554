"""The nouns of the program: what a journal holds, and what everybody reads from it."""
