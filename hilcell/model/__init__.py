"""The nouns of the program, as a journal holds them; every room reads these types."""
