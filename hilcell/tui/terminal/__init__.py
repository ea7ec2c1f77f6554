"""What the terminal at hand can show."""
