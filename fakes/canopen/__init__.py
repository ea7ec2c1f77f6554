"""A rail of a CANopen drive, with its strip on the same bus."""
