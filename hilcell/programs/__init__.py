"""From holes and targets to what a robot is sent: plans, corrected lists and programs, sheets."""
