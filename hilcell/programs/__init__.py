"""From holes and targets to robot commands: plans, corrected lists and programs, drilling
sheets.
"""
