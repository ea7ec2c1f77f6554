"""Shows what the program knows: one table, and what is made of it for people and programs."""
