"""The text of the screen, as pure functions of a `RunView`."""
