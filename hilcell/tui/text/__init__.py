"""What the screen says, as pure functions of the view."""
