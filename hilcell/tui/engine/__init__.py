"""The screen and its engine: starting one, following one, and what is known of it."""
