"""Runs: orders and their plans, the engine, state machines, interlocks, the worker, control."""
