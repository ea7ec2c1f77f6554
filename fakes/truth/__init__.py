"""The one physical truth of a simulated cell, with mathematics of its own."""
