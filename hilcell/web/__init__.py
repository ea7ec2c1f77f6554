"""A page for viewers elsewhere: one run, read from its journal, over HTTP; it sends no command."""
