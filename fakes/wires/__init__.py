"""How servers hear and answer: threads, lines, late and cut segments."""
