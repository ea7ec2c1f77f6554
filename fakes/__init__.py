"""The simulated cell: one physical truth, one server a protocol, in a process of its own."""
